"""The command ``mrtask``: the pipeline's stages, a planner's score and a check of this machine.

``mrtask <stage> KEY=VALUE ...`` is ``python -m pipeline.<stage>`` of a checkout, and works without one: in an installed
mrtask the stages are in the package ``mrtask.pipeline``.
"""

import runpy
import sys
from importlib.util import find_spec

STAGES = {
    "reproduce": "the whole experiment: homes, dataset, training, evaluation, report",
    "homes": "generates or reads homes and splits them",
    "dataset": "labels which objects lie in which containers",
    "train": "trains and registers the likelihood model",
    "evaluate": "runs every planner on every trial",
    "report": "writes the report of an evaluation",
    "realism": "compares generated homes with real ones",
    "housekeep": "measures models on where people put objects that they never saw",
    "ablation": "switches between the text of the paper and its authors' code, one by one",
    "sensitivity": "draws what the planner saves against one factor of the experiment at a time",
    "priors": "what a wrong prior costs, and what a belief that learns wins back",
    "optimality": "measures how far planners are from the best that any planner could do",
    "replay": "makes an episode to be watched, with the beliefs and the reasons",
}
TOOLS = {
    "score": ("mrtask.suite.score", "scores a planner on a suite of trials that never changes"),
    "doctor": ("mrtask.doctor", "checks this machine and says what to do"),
}
NEEDED = ("hydra", "ray", "mlflow", "torch", "sentence_transformers")
"""What stages import and the library does not."""
USER_ERROR_EXIT = 2


def main() -> None:
    """Runs the command on the command line."""
    command = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if command in ("-h", "--help", "help"):
        print(usage())
    elif command in TOOLS:
        _run(TOOLS[command][0])
    elif command not in STAGES:
        sys.exit(_fail(f"no command {command!r}\n{usage()}"))
    elif missing := [name for name in NEEDED if find_spec(name) is None]:
        sys.exit(_fail(f"mrtask {command} needs {', '.join(missing)}: pip install 'mrtask[pipeline]'"))
    else:
        _run(f"{_stages_package()}.{command}")


def usage() -> str:
    """What the command can do."""
    described = STAGES | {name: text for name, (_, text) in TOOLS.items()}
    lines = [f"  mrtask {name:11} {text}" for name, text in described.items()]
    return "\n".join(["usage: mrtask COMMAND [KEY=VALUE ...]", *lines, "mrtask COMMAND --help says more"])


def _stages_package() -> str:
    """``mrtask.pipeline`` where mrtask was installed from a wheel, ``pipeline`` in a checkout."""
    return "mrtask.pipeline" if find_spec("mrtask.pipeline") else "pipeline"


def _run(module: str) -> None:
    # As `python -m` leaves it while it looks for the module.
    sys.argv = ["-m", *sys.argv[2:]]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _fail(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return USER_ERROR_EXIT


if __name__ == "__main__":
    main()
