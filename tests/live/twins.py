"""A live team and a simulated episode on the same events.

To compare them by hand for every planner on 100 trials, run ``python -m tests.live.twins 100``.
"""

from dataclasses import replace

import numpy as np

from mrtask.execution.episode import run_episode
from mrtask.execution.perception import Perception, Rates
from mrtask.execution.sensor import Sensor
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trials import TrialOptions, home_order, key_seed, sample_trial
from mrtask.planning.planners import PLANNERS, make_planner
from tests.live.world import World, live_team, setup_of

HONEST = [name for name in PLANNERS if name != "known"]
OPTIONS = {"pouct": {"samples": 25}, "pouct_paper": {"samples": 25}}
SPECS = [RobotSpec(), RobotSpec(0.7, 1.5, 2.5), RobotSpec(1.0, 0.0, 1.0), RobotSpec(1.0, 2.0, 0.0)]
ERRING = Perception(Rates(0.75, 0.08))


def sample(homes, maps, number, size_classes=("small", "medium")):
    """A trial; of five in a row the last has robots whose searches err."""
    size_class, robots = size_classes[number % len(size_classes)], 1 + number % 3
    spec = SPECS[number % 4]
    trial = sample_trial(
        size_class,
        robots,
        number,
        home_order(homes, size_class, robots, 0),
        lambda home: maps[home.id],
        seed=0,
        options=TrialOptions(robot=replace(spec, perception=ERRING) if number % 5 == 4 else spec),
    )
    home = next(home for home in homes if home.id == trial.home_id)
    likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
    return trial, home, maps[home.id], likelihood


def world_of(trial, home):
    spec = trial.team.members[0]
    contents = {container.id: container.objects for container in home.containers}
    sensor = Sensor.of(spec.perception, trial.objects)
    numbers = {container.id: number for number, container in enumerate(home.containers)}

    def detect(container, search):
        present = np.array([name in contents[container] for name in trial.objects])
        seen = sensor.detect(present, key_seed(trial.seed, "search", numbers[container], search))
        return tuple(name for name, there in zip(trial.objects, seen, strict=True) if there)

    return World(contents, spec.speed_m_per_s, spec.search_time_s, spec.interact_time_s, detect=detect)


def play(live, world):
    world.obey(live.begin())
    while not live.team.accepted and world.settle(live):
        pass
    return live


def check_twins(trial, home, home_map, likelihood, planner):
    """Raises AssertionError where the live team does anything else than the simulated one; gives the decisions."""
    options = OPTIONS.get(planner)
    simulated = run_episode(trial, home, home_map, likelihood, make_planner(planner, options))
    live = live_team(setup_of(trial, home, home_map, likelihood, planner, options), trial)
    live.team.one_per_letter = False  # simulated robots may interact two at a time where one letter is wanted
    play(live, world_of(trial, home))
    assert live.team.accepted == (simulated.status == "accepted")
    assert live.team.trace() == simulated.trace
    assert live.decisions == simulated.decisions
    return live.decisions


def main(count):
    import pipeline  # noqa: F401 - kernels from the cache
    from mrtask.homes.generator.house import generate_house
    from mrtask.homes.procthor import parse_house
    from mrtask.maps.home_map import build_map

    sizes = ("small", "medium", "large")
    homes = [parse_house(generate_house(seed, size), None, "generated", seed) for size in sizes for seed in range(8)]
    maps = {home.id: build_map(home) for home in homes}
    for planner in HONEST:
        decisions = [check_twins(*sample(homes, maps, number, sizes), planner) for number in range(count)]
        print(f"{planner}: {count} trials, {sum(decisions)} decisions, all equal", flush=True)


if __name__ == "__main__":
    import sys

    main(int(sys.argv[1]))
