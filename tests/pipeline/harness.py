"""How tests run stages, and what they run them on."""

import runpy
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.app import sweep

ROOT = Path(__file__).resolve().parents[2]
SMALL = (
    "homes.train=12",
    "homes.validation=3",
    "homes.test=9",
    "model=frequency",
    "planner.pouct.samples=20",
    "evaluation.planners=[nonlearned_myopic,pouct]",
    "evaluation.trials_per_cell=2",
    "evaluation.robots=[1,2]",
)
"""The whole pipeline in seconds: the frequency table needs neither embeddings nor training."""


@dataclass(frozen=True)
class Finished:
    """A stage's exit code and what it said."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Workspace:
    """A folder with a reproduced small experiment; commands run in it share its homes, model and registry."""

    path: Path
    overrides: tuple[str, ...]

    @property
    def output_dir(self) -> Path:
        """The finished experiment's folder; tests that write take a folder of their own."""
        return self.path / "outputs" / "paper"


Cli = Callable[..., Finished]


def run_stage(stage: str, *overrides: str) -> int:
    """A stage in this process, as ``python -m pipeline.<stage>`` would run it; returns the exit code."""
    argv = sys.argv
    sys.argv = ["-m", *overrides]
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*found in sys.modules")  # it is, in a process of tests
            runpy.run_module(f"pipeline.{stage}", run_name="__main__", alter_sys=True)
    except SystemExit as stop:
        return int(stop.code or 0)
    finally:
        sys.argv = argv
        sweep._sweep = None
    return 0


Cli = Callable[..., Finished]
