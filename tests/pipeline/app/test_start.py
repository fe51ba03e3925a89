"""How soon a stage answers: mistakes and --help before anything heavy is imported."""

import ast
import json
import subprocess
import sys

import pytest

from mrtask.cli import STAGES
from mrtask.errors import USER_ERROR_EXIT
from tests.pipeline.harness import ROOT

HEAVY = {"ray", "mlflow", "torch", "matplotlib", "pandas", "scipy", "numba", "pyarrow", "numpy", "fsspec"}
RUN = """
import json, runpy, sys
imported = []
for stage, *arguments in json.loads(sys.argv[1]):
    sys.argv = ["-m", *arguments]
    try:
        runpy.run_module(f"pipeline.{stage}", run_name="__main__", alter_sys=True)
    except SystemExit as stop:
        # A package that is loaded when first used is there by its own name only.
        imported.append([stop.code or 0, sorted({name.split(".")[0] for name in sys.modules if "." in name})])
print("imported:", json.dumps(imported))
"""


def started(*commands: list[str]) -> tuple[list[tuple[int, set[str]]], str]:
    """Each command's exit code and the packages that are imported after it, all in one process; and what it said."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, json.dumps(commands)], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    said, _, imported = done.stdout.partition("imported: ")
    assert imported, done.stderr
    return [(code, set(packages)) for code, packages in json.loads(imported)], said + done.stderr


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_calls_main_before_its_other_imports(stage: str) -> None:
    """They take seconds, and a mistake in the configuration needs none of them."""
    _, imported, called, *_ = ast.parse((ROOT / "pipeline" / f"{stage}.py").read_text()).body
    assert ast.unparse(imported) == "from pipeline.app.main import main"
    assert ast.unparse(called).startswith(f"if __name__ == '__main__':\n    main('pipeline.{stage}'")


def test_mistakes_and_help_are_answered_before_anything_heavy_is_imported() -> None:
    answers, said = started(
        ["report", "evaluation.planer=1"],
        ["evaluate", "evaluation.planners=[pouct,pouctt]"],
        ["evaluate", "-m", "evaluation.robots=[1],[0]"],
        ["train", "trainer=3"],
        ["replay", "--help"],
    )
    assert [code for code, _ in answers] == [*[USER_ERROR_EXIT] * 4, 0]
    assert "evaluation.planer: no such key; did you mean planners?" in said
    assert "unknown planner 'pouctt'; did you mean pouct?" in said
    assert "the sweep does not start:" in said and "evaluation.robots.0=0: must be at least 1" in said
    assert "trainer=3: no such option of the group; allowed: default" in said
    assert "Replays an episode in one HTML file" in said
    assert answers[1][1] & HEAVY == set(), "a wrong name was told after the searches were imported"
    assert answers[-1][1] & {"ray", "mlflow", "torch", "matplotlib", "pandas", "pyarrow"} == set(), "of earlier checks"
