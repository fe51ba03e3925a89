"""Homes of your own: written down in Python, or read from house files in ProcTHOR's schema.

`python examples/own_homes.py`, or `python examples/own_homes.py houses.jsonl.gz asset-database.json`.
"""

import sys
from pathlib import Path

from mrtask import Container, Door, Home, Room, build_map, fit_on_homes, generate_homes, read_houses, run_experiment


def two_rooms() -> Home:
    """A kitchen and a bedroom, 4 m by 3 m each; metres on the floor, any names for rooms and types."""

    def box(x: float, y: float, width: float, depth: float) -> tuple[tuple[float, float], ...]:
        return ((x, y), (x + width, y), (x + width, y + depth), (x, y + depth))

    return Home(
        source="my flat",
        rooms=(Room("kitchen", "Kitchen", box(0, 0, 4, 3)), Room("bedroom", "Bedroom", box(4, 0, 4, 3))),
        doors=(Door("door", ("kitchen", "bedroom"), start=(4, 1), end=(4, 2)),),
        containers=(
            Container("fridge", "Fridge", "kitchen", box(0.1, 0.1, 0.7, 0.7), ("Apple", "Egg")),
            Container("counter", "CounterTop", "kitchen", box(1.5, 2.4, 2.0, 0.6), ("Bread", "Mug")),
            Container("bed", "Bed", "bedroom", box(6.0, 0.1, 1.9, 1.6), ("Laptop", "Pillow")),
            Container("desk", "Desk", "bedroom", box(4.5, 2.4, 1.2, 0.6), ("Book", "Mug")),
        ),
        obstacles=(),
    )


def main(arguments: list[str]) -> None:
    """Runs planners on them."""
    if arguments:
        assets = Path(arguments[1]) if len(arguments) > 1 else None
        homes = list(read_houses([Path(arguments[0])], assets))
    else:
        homes = [two_rooms()]
    for home in homes[:3]:
        home_map = build_map(home)
        ways_m = home_map.travel_m[home_map.reachable][:, home_map.reachable]
        print(
            f"{home.source}: {home.area_m2:.0f} m2, {len(home.containers)} containers, "
            f"{home_map.reachable.sum()} of them reachable, the longest way {ways_m.max():.1f} m"
        )
    episodes = run_experiment(
        homes, ["nonlearned_myopic", "greedy"], fit_on_homes(generate_homes(12)), robots=[1, 2], trials_per_cell=3
    )
    print(episodes[["trial_id", "formula", "planner", "status", "cost_s"]].round(1).to_string(index=False))


if __name__ == "__main__":
    main(sys.argv[1:])
