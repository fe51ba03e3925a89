"""The problem that a planner sees when it has to decide, and the plan with which it answers.

A problem holds the task's automaton, the team, travel times and the *belief*: the probability, for every container and
task object, that the object is there. It does not hold the truth. Legend for array shapes: R robots, C containers, O
task objects, Z automaton states.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.tasks.automaton import Automaton

WAIT = -1
"""The container of an assignment, and the action of a search, with which a robot stays where it is until the next
decision."""

SAME_INSTANT_S = 1e-9
"""Events at most this far apart happen at the same instant."""

ANY_SAFE = -1
"""The interaction of an assignment with which the robot makes every interaction that cannot hurt; see `safe`."""

NONE_UNNAMED = -2
"""The interaction of an assignment with which the robot interacts with nothing: its planner names each interaction."""

REASSIGN = ("all", "free")
"""Which robots decide after the team has learned or done something: ``all`` includes those under way, ``free`` does
not."""


class Assignment(NamedTuple):
    """One robot's action: go to ``container`` (or `WAIT`), search it if no robot has done so, then interact there.

    The ``interaction`` is a task object's index, `ANY_SAFE` or `NONE_UNNAMED`. With an index, the robot interacts with
    that object only, if the object is there and advances the task.
    """

    container: int
    interaction: int = ANY_SAFE


@dataclass(frozen=True, eq=False)
class RobotKind:
    """What robots of one kind have in common: their ways, their times and what they can touch."""

    travel_s: Floats
    """[C, C] seconds between containers; inf to and from those that such a robot cannot reach or open."""
    search_time_s: float = 0.0
    interact_time_s: float = 0.0
    handles: Bools | None = None
    """[O] the task objects with which it can interact; None: all."""

    def __post_init__(self) -> None:
        if np.isnan(self.travel_s).any() or (self.travel_s < 0).any():
            raise ValueError("travel_s must be >= 0 (inf where there is no way)")


@dataclass(frozen=True, eq=False)
class RobotStatus:
    """Where one robot is and what it is doing.

    A *free* robot needs an assignment. A robot *under way* (``target >= 0``) may be redirected if the problem allows
    it. Any other robot is *busy* searching or interacting at ``place`` for another ``remaining_s``.
    """

    travel_s: Floats
    """[C] seconds from the robot's position to each container; inf if it is unreachable."""
    place: int = -1
    """The container at which the robot stands; -1 if it stands anywhere else."""
    free: bool = True
    target: int = -1
    """The container to which a robot under way is going."""
    interaction: int = ANY_SAFE
    """The interaction that belongs to the present action."""
    remaining_s: float = 0.0
    """Seconds until a robot under way arrives, or until a busy robot's search or interaction ends."""
    interacting: int = -1
    """The object with which a busy robot interacts; -1 while it searches."""
    kind: int = 0
    """The index of the robot's kind in `PlanningProblem.kinds`."""


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """The team's decision problem at one instant.

    In searched containers, ``presence_prob`` ([C, O]) is 0 or 1. Elsewhere it is the likelihood, as if containers were
    independent. The planner itself takes into account that every task object exists somewhere.
    """

    automaton: Automaton
    state: int
    presence_prob: Floats
    searched: Bools
    kinds: tuple[RobotKind, ...]
    robots: tuple[RobotStatus, ...]
    may_redirect: bool = True
    """Whether robots under way may be redirected now. This is so only after the team has learned something: otherwise a
    team between two equally good places would turn round at every arrival and never get anywhere."""

    def __post_init__(self) -> None:
        containers, objects = self.presence_prob.shape
        for kind in self.kinds:
            if kind.travel_s.shape != (containers, containers) or self.searched.shape != (containers,):
                raise ValueError(
                    f"travel_s {kind.travel_s.shape} and searched {self.searched.shape} must be [C, C] and [C] with "
                    f"the C = {containers} of presence_prob"
                )
            if kind.handles is not None and kind.handles.shape != (objects,):
                raise ValueError(f"handles {kind.handles.shape} must be [O] with the O = {objects} of presence_prob")
        if objects != len(self.automaton.propositions):
            raise ValueError(f"presence_prob has {objects} objects, the automaton {len(self.automaton.propositions)}")
        if not self.robots:
            raise ValueError("a team needs at least one robot")
        if any(not 0 <= robot.kind < len(self.kinds) for robot in self.robots):
            raise ValueError(f"a robot's kind must be one of the {len(self.kinds)} kinds of the problem")
        if not ((self.presence_prob >= 0) & (self.presence_prob <= 1)).all():
            raise ValueError("presence_prob must lie in [0, 1]")

    @property
    def alike(self) -> bool:
        """Whether all robots are of one kind and can touch everything."""
        return len({robot.kind for robot in self.robots}) == 1 and bool(self.handles.all())

    @property
    def handles(self) -> Bools:
        """Return the objects [R, O] that each robot can touch."""
        everything = np.ones(self.presence_prob.shape[1], dtype=bool)
        masks = [self.kinds[robot.kind].handles for robot in self.robots]
        return np.array([everything if mask is None else mask for mask in masks])

    @property
    def reach(self) -> Bools:
        """Return the containers [R, C] to which each robot can get."""
        return np.isfinite([robot.travel_s for robot in self.robots])

    @property
    def touchable(self) -> Bools:
        """Return [C, O] whether some robot that can get to the container can touch the object."""
        return np.asarray((self.reach[:, :, None] & self.handles[:, None, :]).any(axis=0))

    @property
    def interacting_takes_time(self) -> bool:
        """Whether any robot's interactions take time."""
        return any(self.kinds[robot.kind].interact_time_s > 0 for robot in self.robots)

    @property
    def searching_takes_time(self) -> bool:
        """Whether any robot's searches take time."""
        return any(self.kinds[robot.kind].search_time_s > 0 for robot in self.robots)

    def holds(self, container: int, obj: int) -> bool:
        """Return whether the object is known to be in the container."""
        return bool(self.searched[container]) and self.presence_prob[container, obj] > 0

    def on_own_ways(self, robot: RobotStatus) -> bool:
        """Return whether a robot stands at a container from which its kind's ways do not lead where its own ones do."""
        there = np.isfinite(self.kinds[robot.kind].travel_s[robot.place])
        return robot.place >= 0 and bool((there != np.isfinite(robot.travel_s)).any())

    def deciders(self, reassign: str) -> list[int]:
        """Return the robots that a planner may assign: the free ones and, with ``all``, those it may redirect now."""
        redirect = reassign == "all" and self.may_redirect
        return [index for index, robot in enumerate(self.robots) if robot.free or (redirect and robot.target >= 0)]

    def found(self) -> Bools:
        """Return, for each object [O], whether some container is known to hold it where a robot can touch it."""
        known = (self.presence_prob > 0) & self.searched[:, None] & self.touchable
        return np.asarray(known.any(axis=0))

    def obtainable(self) -> Bools:
        """Return the objects [O] that were found, or that may be where a robot can search and another touch them."""
        return np.asarray(self.found() | (self.touchable & ~self.searched[:, None]).any(axis=0))


@dataclass(frozen=True)
class PlanInfo:
    """Why a plan was chosen. Search planners fill in every field; rule-based planners fill in only ``planning_s``.

    A search decides for one robot after the other. ``root`` lists the candidate actions of the first robot,
    ``root_robot``, starting with the most visited: ``(assignment, visits, mean cost in s, spread in s)``. A plan known
    to be optimal without a search has a ``value_s`` and no samples.
    """

    planning_s: float = 0.0
    samples: int = 0
    tree_nodes: int = 0
    value_s: float = float("nan")
    root: tuple[tuple[Assignment, int, float, float], ...] = ()
    root_robot: int = -1
    """-1 if ``root`` is empty."""


@dataclass(frozen=True)
class Plan:
    """An assignment for every robot that gets a new one. All other robots continue what they are doing."""

    assignments: dict[int, Assignment]
    info: PlanInfo = field(default_factory=PlanInfo)


def check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ValueError unless an option has one of its allowed values."""
    if value not in allowed:
        raise ValueError(f"{name} must be {' or '.join(map(repr, allowed))}, not {value!r}")


def safe(automaton: Automaton) -> Bools:
    """Return the interactions [Z, O] that advance the task and cannot hurt.

    An interaction cannot hurt if every word that would have completed the task still does: ``L(delta(z, w))`` contains
    ``L(z)``.
    """
    after = automaton.transitions
    before = np.arange(len(after))[:, None]
    result: Bools = automaton.advancing & automaton.includes[after, before]
    return result


def needed(automaton: Automaton) -> Bools:
    """Return the objects [Z, O] that advance the task in a state, or in a later one that can come before acceptance."""
    result: Bools = automaton.advancing.copy()
    while True:
        grown = result.copy()
        for obj in range(result.shape[1]):
            grown |= result[automaton.transitions[:, obj]] & automaton.advancing[:, [obj]]
        if (grown == result).all():
            return result
        result = grown


def worth_interacting(automaton: Automaton, candidates: Bools, available: Bools) -> Bools:
    """Return the ``candidates`` [Z, O] after which the task can finish without returning to the state they leave.

    All others only lose time: a team that returns could have stayed. Only letters of ``available`` [O] count.
    """
    candidates = candidates & available
    if not candidates.any():
        return candidates
    import networkx as nx  # its import takes a tenth of a second, and few tasks have candidates

    accepted = len(automaton.accepting)
    ways_back = nx.DiGraph([(accepted, int(z)) for z in np.flatnonzero(automaton.accepting)])
    for obj in np.flatnonzero(available):
        ways_back.add_edges_from((int(after), z) for z, after in enumerate(automaton.transitions[:, obj]))
    # A state dominates all states from which every way to acceptance leads through it.
    dominators = nx.immediate_dominators(ways_back, accepted)
    tree = nx.DiGraph((before, z) for z, before in dominators.items() if before is not None and z != before)
    tree.add_node(accepted)
    order = {z: number for number, z in enumerate(nx.dfs_preorder_nodes(tree, accepted))}
    last = dict(order)
    for z in nx.dfs_postorder_nodes(tree, accepted):
        last[z] = max([order[z], *(last[child] for child in tree.successors(z))])
    result = candidates.copy()
    for z, obj in zip(*np.nonzero(candidates), strict=True):
        after = int(automaton.transitions[z, obj])
        through = after not in order or (z in order and order[z] <= order[after] <= last[z])
        result[z, obj] = not through
    return result
