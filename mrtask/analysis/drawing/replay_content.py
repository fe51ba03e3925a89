"""An episode to watch: what each planner's robots did, what the team believed, and why each plan was chosen.

It is made from an episode's trace, which every row keeps, and from its decisions, which a `Recorder` collects during a
run of the same episode. Without decisions it still shows the drives, the finds and the task's progress.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from string import ascii_lowercase

import numpy as np

from mrtask.analysis.page.style import planner_label
from mrtask.arrays import Bools, Floats
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home, Point
from mrtask.planning.problem import (
    WAIT,
    Assignment,
    Plan,
    PlanningProblem,
    RobotStatus,
)
from mrtask.tasks.automaton import Automaton
from mrtask.tasks.templates import TEMPLATES

MAX_CANDIDATES = 12
"""Only the most visited candidate actions of a decision are listed."""


@dataclass(frozen=True)
class Observed:
    """A decision as it was taken."""

    t_s: float
    problem: PlanningProblem
    plan: Plan


@dataclass
class Recorder:
    """Keeps the decisions of an episode; an `mrtask.execution.episode.Observer`."""

    decisions: list[Observed] = field(default_factory=list)

    def __call__(self, t_s: float, problem: PlanningProblem, plan: Plan) -> None:
        """Keeps one decision."""
        self.decisions.append(Observed(t_s, problem, plan))


@dataclass(frozen=True)
class Action:
    """What one robot does after a decision; ``new``: by this decision, not an earlier one."""

    robot: int
    container: int
    """-1: waits."""
    text: str
    new: bool


@dataclass(frozen=True)
class Candidate:
    """One action that the search considered for the robot that it decided first."""

    text: str
    visits: int
    mean_s: float
    spread_s: float
    chosen: bool


@dataclass(frozen=True)
class Decision:
    """A decision: the team's belief, the candidates and the choice."""

    t_s: float
    belief: Floats
    """[C, O], see `existence_belief`."""
    actions: tuple[Action, ...]
    samples: int
    robot: int
    """Whose candidates are listed; -1 where there are none."""
    candidates: tuple[Candidate, ...]
    unlisted: int
    """The number of further candidates, which were visited less."""
    expected_s: float | None
    """The time to go that the planner expected; None where it made no estimate."""
    remaining_s: float | None
    """The time that it then took; None where the task was not finished."""


@dataclass(frozen=True)
class Find:
    """A searched container and the task objects (by index) that were in it."""

    t_s: float
    robot: int
    container: int
    objects: tuple[int, ...]
    place: Point
    """Where the robot stood."""


@dataclass(frozen=True)
class Run:
    """One planner's episode."""

    planner: str
    status: str
    cost_s: float | None
    error: str | None
    trace: Trace
    finds: tuple[Find, ...]
    states: tuple[tuple[float, int], ...]
    """``(time in s, automaton state from then on)``."""
    decisions: tuple[Decision, ...] = ()

    @property
    def label(self) -> str:
        """What the page calls the planner."""
        return planner_label(self.planner)

    @property
    def end_s(self) -> float:
        """When the last robot stopped."""
        legs = [leg.t1_s for robot in self.trace.robots for leg in robot]
        return max([*legs, *(letter.t_s for letter in self.trace.letters), self.cost_s or 0.0], default=0.0)


@dataclass(frozen=True)
class Replay:
    """One trial with the episodes of one or more planners."""

    trial_id: str
    size_class: str
    formula: str
    task: str
    """The formula in words."""
    home: Home
    names: tuple[str, ...]
    """Of the containers, in their order; no two alike."""
    automaton: Automaton
    runs: tuple[Run, ...]
    called: tuple[str, ...] = ()
    """The robots' names, empty for one without."""

    @property
    def objects(self) -> tuple[str, ...]:
        """The task's objects."""
        return self.automaton.propositions

    @property
    def robots(self) -> int:
        """How many robots the team has."""
        return max((len(run.trace.robots) for run in self.runs), default=0)

    @property
    def end_s(self) -> float:
        """When the last of the runs ended."""
        return max((run.end_s for run in self.runs), default=0.0)

    def holds(self) -> Bools:
        """[C, O] which container holds which task object."""
        return np.array(
            [[name in container.objects for name in self.objects] for container in self.home.containers], dtype=bool
        ).reshape(len(self.home.containers), len(self.objects))


@dataclass(frozen=True)
class Episode:
    """The source of a replay's run: the row's outcome, its trace, and its decisions if they were recorded."""

    planner: str
    status: str
    cost_s: float | None
    error: str | None
    trace: Trace
    decisions: Sequence[Observed] = ()


def make_replay(
    trial_id: str,
    size_class: str,
    template: str,
    automaton: Automaton,
    home: Home,
    episodes: Sequence[Episode],
    called: Sequence[str] = (),
) -> Replay:
    """The replay of a trial with these planners' episodes, in their order; ``called``: the robots' names, if any.

    Raises:
        ValueError: a trace names a container or an object that the home or the task does not have.
    """
    names = container_names(home)
    return Replay(
        trial_id=trial_id,
        size_class=size_class,
        formula=automaton.formula,
        task=task_in_words(template, automaton.formula, automaton.propositions),
        home=home,
        names=names,
        automaton=automaton,
        runs=tuple(_run(episode, automaton, home, names) for episode in episodes),
        called=tuple(called),
    )


def existence_belief(presence_prob: Floats, searched: Bools) -> Floats:
    """[C, O] the probability that each container holds each object, given that every object exists somewhere.

    This is the belief of a planner that knows that the task can be done: each container searched without success makes
    the others likelier. An object that was found needs no such inference.
    """
    found = ((presence_prob > 0) & searched[:, None]).any(axis=0)
    somewhere = 1.0 - np.prod(np.where(searched[:, None], 1.0, 1.0 - presence_prob), axis=0)
    belief: Floats = np.where(
        found | (somewhere <= 0), presence_prob, presence_prob / np.where(somewhere > 0, somewhere, 1.0)
    )
    return belief


def task_in_words(template: str, formula: str, objects: Sequence[str]) -> str:
    """``Mug or Book, then Plate, then Fork`` for a template's formula; any other formula as it is."""
    if template not in TEMPLATES or len(objects) != TEMPLATES[template].arity:
        return formula
    words: Mapping[str, str] = dict(zip(ascii_lowercase, objects, strict=False))
    return re.sub(r"\b[a-d]\b", lambda letter: words[letter[0]], TEMPLATES[template].meaning)


def container_names(home: Home) -> tuple[str, ...]:
    """``Fridge``, ``Chair 1``, ``Chair 2``: the type, numbered where the home has several."""
    types = [container.type for container in home.containers]
    numbers = [types[: index + 1].count(kind) for index, kind in enumerate(types)]
    return tuple(
        kind if types.count(kind) == 1 else f"{kind} {number}" for kind, number in zip(types, numbers, strict=True)
    )


def _run(episode: Episode, automaton: Automaton, home: Home, names: Sequence[str]) -> Run:
    trace = episode.trace
    place = {container.id: index for index, container in enumerate(home.containers)}
    unknown = {leg.container for legs in trace.robots for leg in legs if leg.container} - place.keys()
    if unknown:
        raise ValueError(f"the trace of {episode.planner} names {sorted(unknown)[0]!r}, which home {home.id} lacks")
    held = [
        tuple(index for index, name in enumerate(automaton.propositions) if name in container.objects)
        for container in home.containers
    ]
    finds = [
        Find(leg.t1_s, robot, place[leg.container], held[place[leg.container]], leg.path[0])
        for robot, legs in enumerate(trace.robots)
        for leg in legs
        if leg.kind == "search" and leg.container
    ]
    states = [(0.0, automaton.initial)]
    for letter in trace.letters:
        states.append((letter.t_s, automaton.run([letter.object], states[-1][1])))
    return Run(
        planner=episode.planner,
        status=episode.status,
        cost_s=episode.cost_s,
        error=episode.error,
        trace=trace,
        finds=tuple(sorted(finds, key=lambda find: (find.t_s, find.robot))),
        states=tuple(states),
        decisions=tuple(_decision(observed, episode.cost_s, names) for observed in episode.decisions),
    )


def _decision(observed: Observed, cost_s: float | None, names: Sequence[str]) -> Decision:
    problem, plan = observed.problem, observed.plan
    objects = problem.automaton.propositions
    first, rows = plan.info.root_robot, plan.info.root
    chosen = next((index for index, row in enumerate(rows) if row[0] == plan.assignments.get(first)), -1)
    listed = list(range(min(len(rows), MAX_CANDIDATES)))
    if chosen >= MAX_CANDIDATES:
        listed[-1] = chosen
    return Decision(
        t_s=observed.t_s,
        belief=existence_belief(problem.presence_prob, problem.searched),
        actions=tuple(
            _action(index, status, plan.assignments.get(index), names, objects)
            for index, status in enumerate(problem.robots)
        ),
        samples=plan.info.samples,
        robot=first,
        candidates=tuple(
            Candidate(_told(rows[index][0], names, objects), *rows[index][1:], chosen=index == chosen)
            for index in listed
        ),
        unlisted=len(rows) - len(listed),
        expected_s=plan.info.value_s if np.isfinite(plan.info.value_s) else None,
        remaining_s=None if cost_s is None else cost_s - observed.t_s,
    )


def _action(
    robot: int, status: RobotStatus, assigned: Assignment | None, names: Sequence[str], objects: Sequence[str]
) -> Action:
    if assigned is not None:
        return Action(robot, assigned.container, _told(assigned, names, objects), True)
    if status.target >= 0:
        return Action(robot, status.target, f"on to {names[status.target]}", False)
    if status.interacting >= 0:
        return Action(robot, status.place, f"goes on with {objects[status.interacting]}", False)
    if status.free:
        return Action(robot, WAIT, "waits", False)
    return Action(robot, status.place, f"goes on searching {names[status.place]}", False)


def _told(assignment: Assignment, names: Sequence[str], objects: Sequence[str]) -> str:
    """``Fridge``, ``Fridge for Egg`` or ``wait``."""
    if assignment.container == WAIT:
        return "wait"
    name = names[assignment.container]
    return name if assignment.interaction < 0 else f"{name} for {objects[assignment.interaction]}"
