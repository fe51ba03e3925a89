"""Drive pyrobosim's robots through homes with the live process, planner beside planner, and print the outcome.

    python -m simulators.pyrobosim count=3 robots=[2]
    python -m simulators.pyrobosim homes=[houses.jsonl.gz] assets=asset-database.json count=30

Each trial is a home, a task of the paper's templates and a team; every planner runs on it. Writes into output_dir
(default outputs/pyrobosim): worlds/<home>/, the files of both sides; episodes.jsonl, one line for each trial and
planner; paths/, where each robot was at every step; summary.txt. The same command again goes on where it was.
Every key: simulators/pyrobosim/options.yaml.
"""

import json
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from mrtask.errors import InputError
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trials import Trial, TrialOptions, home_order, sample_trial
from mrtask.homes.generator.homes import generate_homes
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import read_houses
from mrtask.planning.planners import planners_in_order
from pipeline.app.tool import load_options, main, overrides
from simulators.pyrobosim.robot import Body
from simulators.pyrobosim.summary import summary
from simulators.pyrobosim.world import World, write_world

DEFAULTS = Path(__file__).with_name("options.yaml")
EPISODES, RUN, SUMMARY, PATHS = "episodes.jsonl", "run.json", "summary.txt", "paths"
SPARE = 3
"""The number of homes generated for each home wanted, since not all of them can be used."""

LocalPath = Annotated[Path, AfterValidator(lambda path: path.expanduser().absolute())]


class Options(BaseModel):
    """The options; ``options.yaml`` explains each."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    homes: str | tuple[LocalPath, ...]
    assets: LocalPath | None
    count: int = Field(ge=1)
    in_turn: bool
    robots: tuple[Annotated[int, Field(ge=1, le=8)], ...] = Field(min_length=1)
    planners: tuple[str, ...] = Field(min_length=1)
    likelihood: str
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    seed: int = Field(ge=0)
    planner: dict[str, dict[str, Any]]
    output_dir: LocalPath

    def live_options(self, planner: str) -> list[str]:
        """Return the arguments of `pipeline.live` for this planner."""
        own = self.planner.get(planner, {})
        listed = [f"planner.{planner}.{key}={json.dumps(value)}" for key, value in own.items()]
        return [f"likelihood={self.likelihood}", *listed]


def read_options(arguments: Sequence[str]) -> Options:
    """Read the options from a command line; raise `UserError` with every mistake."""
    return load_options(Options, [DEFAULTS], overrides(arguments))


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    options = read_options(arguments)
    try:
        version("pyrobosim")
    except PackageNotFoundError as error:
        raise InputError(
            "pyrobosim is needed here: make install, or pip install -c constraints.txt pyrobosim"
        ) from error
    logging.disable(logging.WARNING)  # pyrobosim logs everything that it does; what matters is checked
    body = Body()
    rows = _rows_so_far(options)
    done = {(row["trial_id"], row["planner"]) for row in rows}
    for number, world in enumerate(_worlds(options, body)):
        rows += _run_world(world, number, options, body, done)
    text = summary(rows)
    (options.output_dir / SUMMARY).write_text(text + "\n", encoding="utf-8")
    print(text)


def _rows_so_far(options: Options) -> list[dict[str, Any]]:
    """Read the folder's episodes; raise `InputError` if they were made with other options."""
    options.output_dir.mkdir(parents=True, exist_ok=True)
    content = options.model_dump_json(
        include={"homes", "assets", "likelihood", "search_time_s", "interact_time_s", "seed", "planner"}
    )
    identity = json.loads(content) | {"pyrobosim": version("pyrobosim")}
    file = options.output_dir / RUN
    if file.exists() and (before := json.loads(file.read_text(encoding="utf-8"))) != identity:
        changed = ", ".join(key for key in identity if before.get(key) != identity[key])
        raise InputError(f"{options.output_dir} holds episodes with other options ({changed}); give another output_dir")
    file.write_text(json.dumps(identity, indent=1) + "\n", encoding="utf-8")
    episodes = options.output_dir / EPISODES
    lines = episodes.read_text(encoding="utf-8").splitlines() if episodes.exists() else []
    return [json.loads(line) for line in lines]


def _worlds(options: Options, body: Body) -> Iterator[World]:
    """Return the wanted number of usable homes, the size classes taking turns."""
    if options.homes == "generated":
        homes: list[Home] = list(generate_homes(SPARE * options.count, options.seed))
    elif isinstance(options.homes, str):
        raise InputError(f"homes={options.homes}: give generated, or a list of house files in brackets")
    else:
        homes = list(read_houses(options.homes, options.assets, on_error=lambda error: print(f"left out: {error}")))
    waiting = {name: home_order(homes, name, 0, options.seed) for name in SIZE_CLASSES}
    given = 0
    while given < options.count:
        size_class = SIZE_CLASSES[given % len(SIZE_CLASSES)]
        if not waiting[size_class]:
            raise InputError(f"count={options.count}: not enough {size_class} homes can be used")
        home = waiting[size_class].pop(0)
        try:
            world = write_world(home, options.output_dir / "worlds" / home.id, body)
            _trials(world, 0, options, body)
        except (InputError, ValueError) as error:
            print(f"left out: {error}")
            continue
        given += 1
        yield world


def _trials(world: World, number: int, options: Options, body: Body) -> list[Trial]:
    """Return one for each team size, or for the one whose turn it is; homes of the same number have the same turn."""
    spec = RobotSpec(body.speed_m_per_s, options.search_time_s, options.interact_time_s)
    turn = number // len(SIZE_CLASSES) % len(options.robots)
    return [
        sample_trial(
            world.size_class,
            robots,
            number,
            [world.home],
            lambda _: world.home_map,
            seed=options.seed,
            options=TrialOptions(robot=spec),
        )
        for robots in ((options.robots[turn],) if options.in_turn else options.robots)
    ]


def _run_world(
    world: World, number: int, options: Options, body: Body, done: set[tuple[str, str]]
) -> Iterator[dict[str, Any]]:
    from simulators.pyrobosim.trial import load_world, run_trial

    pairs = [
        (trial, planner)
        for trial in _trials(world, number, options, body)
        for planner in planners_in_order(options.planners)
        if (trial.trial_id, planner) not in done
    ]
    if not pairs:
        return
    simulated = load_world(world)
    for trial, planner in pairs:
        began_s = time.perf_counter()
        outcome = run_trial(world, simulated, trial, planner, options.live_options(planner), body)
        facts = {
            "trial_id": trial.trial_id,
            "planner": planner,
            "home_id": world.folder.name,
            "size_class": trial.size_class,
            "robots": trial.team.robots,
            "template": trial.template,
            "formula": trial.formula,
            "left_out": len(world.left_out),
        }
        row = facts | asdict(outcome) | {"took_s": round(time.perf_counter() - began_s, 2)}
        _write_paths(options.output_dir / PATHS / f"{trial.trial_id}-{planner}.json", outcome.paths)
        del row["paths"]
        with (options.output_dir / EPISODES).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        said = f"{outcome.cost_s:.1f} s" if outcome.cost_s is not None else outcome.error
        print(f"{trial.trial_id} {planner}: {said}", flush=True)
        yield row


def _write_paths(file: Path, paths: dict[str, list[tuple[float, float]]]) -> None:
    """Each robot's positions in metres, every `STEP_S`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    rounded = {name: [[round(x, 3), round(y, 3)] for x, y in places] for name, places in paths.items()}
    file.write_text(json.dumps(rounded) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(run, __doc__ or "")
