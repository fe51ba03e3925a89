"""The command ``mrtask``: the pipeline's stages and tools, a planner's score and a check of this machine.

``mrtask <stage> KEY=VALUE ...`` is ``python -m pipeline.<stage>`` of a checkout, and works without one: in an installed
mrtask the stages are in the package ``mrtask.pipeline``.
"""

import runpy
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from mrtask import __version__
from mrtask.errors import refuse

STAGES = {
    "reproduce": "runs the whole experiment: homes, dataset, training, evaluation, report",
    "homes": "generates or reads homes and splits them",
    "dataset": "labels which objects lie in which containers",
    "train": "trains and registers the likelihood model",
    "evaluate": "runs every planner on every trial",
    "report": "writes the report of an evaluation",
    "realism": "compares generated homes with real ones",
    "housekeep": "measures models on where people put objects that they never saw",
    "ablation": "switches between the text of the paper and its authors' code, one by one",
    "sensitivity": "draws what the planner saves against one factor of the experiment at a time",
    "priors": "shows what a wrong prior costs, and what a belief that learns wins back",
    "optimality": "measures how far planners are from the best that any planner could do",
    "replay": "replays an episode as a page to watch, with the beliefs and the reasons",
}
"""The stages that Hydra configures, and what each does."""
STAGES_NEED = ("hydra", "ray", "mlflow", "torch", "sentence_transformers")
"""What stages import and the library does not."""


@dataclass(frozen=True)
class Command:
    """What a command does, the module that it runs, and the packages that this module needs."""

    text: str
    module: str
    needs: tuple[str, ...] = ()


def commands() -> Mapping[str, Command]:
    """Return all commands by name."""
    # In a checkout the stages are in `pipeline`; a wheel has them inside the library.
    package = "mrtask.pipeline" if find_spec("mrtask.pipeline") else "pipeline"
    return {name: Command(text, f"{package}.{name}", STAGES_NEED) for name, text in STAGES.items()} | {
        "scenario": Command("runs one task on one map by every planner", f"{package}.scenario", ("omegaconf",)),
        "live": Command("plans for a team of real robots, from their events", f"{package}.live", ("omegaconf",)),
        "status": Command("says how far a run is, from any machine", f"{package}.status", ("omegaconf", "pyarrow")),
        "champion": Command(
            "lists the models, or makes one the champion that evaluations use",
            f"{package}.champion",
            ("omegaconf", "mlflow"),
        ),
        "clean": Command("removes what runs left here, showing it first", f"{package}.clean", ("omegaconf",)),
        "score": Command("scores a planner on a suite of trials that never changes", "mrtask.suite.score"),
        "doctor": Command("checks this machine and says what to do", "mrtask.doctor"),
    }


def main() -> None:
    """Run the command on the command line."""
    known = commands()
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help", "help"):
        print(usage(known))
    elif name == "--version":
        print(f"mrtask {__version__}")
    elif (command := known.get(name)) is None:
        sys.exit(refuse(f"no command {name!r}\n{usage(known)}"))
    elif missing := [package for package in command.needs if find_spec(package) is None]:
        sys.exit(refuse(f"mrtask {name} needs {', '.join(missing)}: pip install 'mrtask[pipeline]'"))
    else:
        # As `python -m` leaves it while it looks for the module.
        sys.argv = ["-m", *sys.argv[2:]]
        runpy.run_module(command.module, run_name="__main__", alter_sys=True)


def usage(known: Mapping[str, Command]) -> str:
    """Return a line for each command."""
    lines = [f"  mrtask {name:11} {command.text}" for name, command in known.items()]
    more = "mrtask COMMAND --help says more, and mrtask --version which version this is"
    return "\n".join(["usage: mrtask COMMAND [KEY=VALUE ...]", *lines, more])


if __name__ == "__main__":
    main()
