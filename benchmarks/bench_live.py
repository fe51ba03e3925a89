"""Measure how long a live team takes from an event's line to its orders, with a limit of 0.2 s on a decision.

    python benchmarks/bench_live.py [--teams 12] [--planner pouct] [--limit 0.2] [--samples 100000]

The team has 3 robots and a task over four objects, in a generated home with 50 containers. Every event is parsed,
processed, decided on, saved and logged, as in the live process; robots drive in simulated time. Print the median, 99th
percentile and maximum over the events after which the planner decided, and over all others. These are wall times, so
use a quiet machine.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

import pipeline  # noqa: F401 - kernels from the cache
from mrtask.execution.team_spec import RobotSpec
from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import Home
from mrtask.homes.procthor import parse_house
from mrtask.live.live_team import LiveTeam
from mrtask.live.session import LiveSession
from mrtask.live.state import LiveSetup
from mrtask.maps.home_map import HomeMap, build_map
from mrtask.tasks.words import ReadTask

CONTAINERS, ROBOTS = 50, 3
OBJECTS = ("Mug", "Book", "Remote", "Laptop")
FORMULA = "(((!Remote & !Laptop) U Mug) | ((!Remote & !Laptop) U Book)) & (!Laptop U Remote) & F Laptop"
SPEC = RobotSpec(speed_m_per_s=0.5, search_time_s=5.0, interact_time_s=5.0)
SEEDS = range(200)


def big_home() -> tuple[Home, HomeMap]:
    """Return the first generated home with at least this many reachable containers."""
    for seed in SEEDS:
        home = parse_house(generate_house(seed, "large"), None, "generated", seed)
        if len(home.containers) >= CONTAINERS:
            home_map = build_map(home)
            if home_map.reachable.sum() >= CONTAINERS:
                return home, home_map
    raise SystemExit(f"none of {len(SEEDS)} homes has {CONTAINERS} containers that can be reached")


class Robots:
    """Robots that carry out orders in simulated time and report in lines of JSON."""

    def __init__(self, contents: dict[str, tuple[str, ...]]) -> None:
        self.contents, self.time_s, self.count = contents, 0.0, 0
        self.due: dict[str, tuple[float, dict]] = {}

    def obey(self, lines: list[str]) -> None:
        """Take the orders from the live team's lines."""
        for message in map(json.loads, lines):
            if message["type"] == "order":
                took_s = {"search": SPEC.search_time_s, "interact": SPEC.interact_time_s, "wait": np.inf}.get(
                    message["action"], message["length_m"] / SPEC.speed_m_per_s
                )
                self.due[message["robot"]] = (self.time_s + took_s, message)

    def next_event(self) -> str | None:
        """Return the next event, or None if no robot does anything."""
        robot, (at_s, order) = min(self.due.items(), key=lambda item: item[1][0])
        if at_s == np.inf:
            return None
        self.due[robot] = (np.inf, order)
        self.time_s, self.count = at_s, self.count + 1
        event = {"id": f"e{self.count}", "time_s": at_s, "robot": robot, "container": order["container"]}
        if order["action"] == "navigate":
            event |= {"type": "arrived"}
        elif order["action"] == "search":
            event |= {"type": "search_ended", "objects": self.contents[order["container"]]}
        else:
            event |= {"type": "interaction_ended", "object": order["object"]}
        return json.dumps(event)


def run_team(home: Home, home_map: HomeMap, seed: int, args: argparse.Namespace, folder: Path) -> tuple[list, list]:
    """Return the seconds from line to answer over a whole task, for events with a decision and for those without."""
    rng = np.random.default_rng(seed)
    reachable = np.flatnonzero(home_map.reachable)
    places = rng.choice(reachable, len(OBJECTS), replace=False)
    contents = {container.id: () for container in home.containers}
    contents |= {home.containers[place].id: (name,) for name, place in zip(OBJECTS, places, strict=True)}
    options = {"samples": args.samples, "time_limit_s": args.limit} if args.planner.startswith("pouct") else {}
    setup = LiveSetup(
        home,
        home_map,
        FORMULA,
        ReadTask(FORMULA, OBJECTS),
        rng.beta(0.3, 5.0, (len(home.containers), len(OBJECTS))),
        SPEC,
        args.planner,
        options,
        seed,
    )
    starts = rng.permutation(np.argwhere(home_map.free))[:ROBOTS]
    live = LiveTeam(setup, {f"r{n}": home_map.cell_center((int(r), int(c))) for n, (r, c) in enumerate(starts)})
    session, robots = LiveSession(live, folder / "state.json", folder / "log.jsonl"), Robots(contents)
    robots.obey(session.begin())
    deciding, others = [], []
    while not live.team.accepted and (line := robots.next_event()) is not None:
        decisions, began_s = live.decisions, time.perf_counter()
        answers, news = session.receive(line)
        took_s = time.perf_counter() - began_s
        assert json.loads(answers[0])["status"] == "accepted", answers
        (deciding if live.decisions > decisions else others).append(took_s)
        robots.obey(news)
    assert live.team.accepted, "the task was not done"
    return deciding, others


def show(name: str, seconds: list[float], limit_s: float | None) -> None:
    """Print one line of the table."""
    ms = np.array(seconds) * 1000
    late = f"{(np.array(seconds) > limit_s).mean():9.1%}" if limit_s else ""
    print(f"{name:<28}{len(ms):8}{np.median(ms):10.1f}{np.percentile(ms, 99):10.1f}{ms.max():10.1f}{late}")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--teams", type=int, default=12)
    parser.add_argument("--planner", default="pouct")
    parser.add_argument("--limit", type=float, default=0.2)
    parser.add_argument("--samples", type=int, default=100_000, help="as in conf/planner")
    args = parser.parse_args()
    home, home_map = big_home()
    print(f"{home_map.reachable.sum()} containers, {ROBOTS} robots, {args.planner}, limit {args.limit:g} s")
    deciding: list[float] = []
    others: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        run_team(home, home_map, 0, args, Path(folder))  # compiles
        for seed in range(1, args.teams + 1):
            one, two = run_team(home, home_map, seed, args, Path(folder))
            deciding += one
            others += two
    print(f"{'ms from event to orders':<28}{'events':>8}{'median':>10}{'99 %':>10}{'most':>10}{'late':>9}")
    show("with a decision", deciding, args.limit)
    show("without", others, None)


if __name__ == "__main__":
    main()
