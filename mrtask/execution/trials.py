"""Trials: the home, task, start and team of an episode. All randomness of a trial comes from its own key."""

import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from mrtask.execution.team_spec import ALIKE, RobotSpec, Team
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap
from mrtask.tasks.automaton import NEVER_ACCEPTS, Automaton, build_automaton, check_task
from mrtask.tasks.formula import parse
from mrtask.tasks.templates import PAPER_TEMPLATES, TEMPLATES, make_formula

COSTS = ("makespan", "least_motion")
"""The cost of an episode: the time until the task is done, or the driving time of the robot that drove least (as in the
authors' code)."""
HOME_ORDERS = ("shuffled", "file")
"""The order in which a cell's trials take the homes: shuffled for each cell, or the files' order, the same for all team
sizes (as in the authors' code)."""


@dataclass(frozen=True)
class Trial:
    """One paired comparison: every planner runs on the same home, task, start and world."""

    trial_id: str
    home_id: str
    size_class: str
    team: Team
    template: str
    formula: str
    objects: tuple[str, ...]
    start_cell: tuple[int, int]
    seed: int
    known: tuple[int, ...] = ()
    """The indices of the home's containers whose contents every planner knows from the start."""
    cost: str = "makespan"
    """One of `COSTS`."""


@dataclass(frozen=True)
class TrialOptions:
    """The tasks of trials, from templates or from the user's ``formula`` over ``formula_objects``, and the robots."""

    templates: tuple[str, ...] = PAPER_TEMPLATES
    formula: str | None = None
    formula_objects: tuple[str, ...] = ()
    robot: RobotSpec = field(default_factory=RobotSpec)
    team: Team | None = None
    """The robots, of whom trials take the first; None: as many as a trial has, all like ``robot``."""
    tasks_per_home: int = 1
    """The number of successive trials in one home."""
    unsearched_share: tuple[float, float] = (1.0, 1.0)
    """The share of unsearched containers is drawn between these for each trial; all others are known from the start."""
    cost: str = "makespan"
    """One of `COSTS`."""

    @property
    def team_name(self) -> str:
        """The name of the team, whatever its size."""
        return ALIKE if self.team is None else self.team.name


def trial_id(size_class: str, robots: int, number: int) -> str:
    """Return the key of a trial: ``medium-2-017``."""
    return f"{size_class}-{robots}-{number:03d}"


def key_seed(*key: int | str) -> int:
    """Return a 63-bit seed that depends on the key alone."""
    words = [part if isinstance(part, int) else zlib.crc32(part.encode()) for part in key]
    return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0] >> np.uint64(1))


def home_order(homes: Sequence[Home], size_class: str, robots: int, seed: int, order: str = "shuffled") -> list[Home]:
    """Return the homes of a class in the order in which a cell's trials take them; see `HOME_ORDERS`.

    The shuffled order does not depend on the order of ``homes``.
    """
    members = [home for home in homes if home.size_class == size_class]
    if order == "file":
        return members
    members.sort(key=lambda home: home.id)
    rng = np.random.default_rng(key_seed(seed, "homes", size_class, robots))
    return [members[index] for index in rng.permutation(len(members))]


def reachable_objects(home: Home, home_map: HomeMap) -> list[str]:
    """Return the distinct objects in the containers that a robot can reach, sorted."""
    reached = home_map.reachable
    return sorted(
        {name for container, ok in zip(home.containers, reached, strict=True) if ok for name in container.objects}
    )


def objects_in(homes: Sequence[Home]) -> set[str]:
    """Return the names of all objects in the containers of these homes."""
    return {name for home in homes for container in home.containers for name in container.objects}


def check_formula(formula: str, homes: Sequence[Home]) -> tuple[str, ...]:
    """Return the objects of a formula for trials in these homes, in order of appearance.

    Raises:
        FormulaError: no home has one of the objects, or the formula is none of a task (see `check_task`).
    """
    automaton = check_task(build_automaton(formula))
    parse(formula, objects_in(homes))
    return automaton.propositions


def can_serve(formula: str, objects: tuple[str, ...], there: Collection[str]) -> bool:
    """Return whether the task over ``objects`` can be done with those that are ``there``."""
    automaton = _automaton(formula, objects)
    available = np.array([name in there for name in objects], dtype=bool)
    return bool(automaton.steps_with(available)[automaton.initial] < NEVER_ACCEPTS)


@lru_cache(maxsize=8)
def _automaton(formula: str, objects: tuple[str, ...]) -> Automaton:
    return build_automaton(formula, objects)


def sample_trial(
    size_class: str,
    robots: int,
    number: int,
    order: Sequence[Home],
    map_of: Callable[[Home], HomeMap],
    *,
    seed: int,
    options: TrialOptions | None = None,
) -> Trial:
    """Return the ``number``-th trial of a cell, on the homes of `home_order`.

    The template is drawn among those for which the home has enough distinct reachable objects. The objects and the
    start cell are drawn uniformly. Homes with too few objects for every template are skipped. A ``formula`` in the
    options replaces the templates in every trial, and homes in which robots cannot reach what it needs are skipped.

    Raises:
        ValueError: no home of the class has enough objects.
    """
    options = options or TrialOptions()
    rng = np.random.default_rng(key_seed(seed, "trial", size_class, robots, number))
    share_rng = np.random.default_rng(key_seed(seed, "known", size_class, robots, number))
    for step in range(len(order)):
        home = order[(number // options.tasks_per_home + step) % len(order)]
        home_map = map_of(home)
        names = reachable_objects(home, home_map)
        if options.formula is not None:
            if not can_serve(options.formula, options.formula_objects, names):
                continue
            template, text, objects = "formula", options.formula, options.formula_objects
        else:
            fitting = [name for name in options.templates if TEMPLATES[name].arity <= len(names)]
            if not fitting:
                continue
            template = fitting[int(rng.integers(len(fitting)))]
            objects = tuple(str(name) for name in rng.choice(names, TEMPLATES[template].arity, replace=False))
            text = make_formula(template, objects)
        cells = np.argwhere(home_map.free)
        row, col = cells[int(rng.integers(len(cells)))]
        return Trial(
            trial_id=trial_id(size_class, robots, number),
            home_id=home.id,
            size_class=size_class,
            team=Team.alike(robots, options.robot) if options.team is None else options.team.first(robots),
            template=template,
            formula=text,
            objects=objects,
            start_cell=(int(row), int(col)),
            seed=key_seed(seed, "planner", size_class, robots, number),
            known=known_containers(home, objects, options.unsearched_share, share_rng),
            cost=options.cost,
        )
    wanted = options.formula or f"any of the templates {', '.join(options.templates)}"
    raise ValueError(
        f"no {size_class} home has enough distinct reachable objects for {wanted}; "
        f"give other evaluation homes or tasks ({len(order)} homes tried)"
    )


def known_containers(
    home: Home, objects: Sequence[str], unsearched_share: tuple[float, float], rng: np.random.Generator
) -> tuple[int, ...]:
    """Draw the containers known from the start: all but a share between the bounds, none with a task object.

    The authors' code draws trials in this way. The share is exceeded if more containers hold such objects.
    """
    count = len(home.containers)
    unsearched = round(rng.uniform(*unsearched_share) * count)
    empty = [index for index, container in enumerate(home.containers) if not set(container.objects) & set(objects)]
    known = rng.permutation(empty)[: count - unsearched]
    return tuple(sorted(int(index) for index in known))
