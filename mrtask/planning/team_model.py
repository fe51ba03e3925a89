"""Translate a planning problem into the terms of the team's compiled simulation, and back."""

import numpy as np
from numpy.typing import ArrayLike

from mrtask.arrays import Bools, Floats, Ints
from mrtask.planning import team_kernel as kernel
from mrtask.planning.compiled import Records
from mrtask.planning.problem import (
    ANY_SAFE,
    WAIT,
    Assignment,
    PlanningProblem,
    needed,
    safe,
    worth_interacting,
)
from mrtask.planning.shared_kernel import AUTOMATON, NONE, STATE
from mrtask.tasks.automaton import Automaton

MIN_PROB = 1e-6
"""Likelihoods of 0 and 1 move inside the open interval by this much: a container that should hold nothing is searched
last, not never."""
MAX_OBJECTS = 30
MOVES_PER_EVENT = 4
"""Between two events at which something is learned or done, a robot of a rollout makes fewer moves than this."""


def team_model(problem: PlanningProblem, decide_all: bool = False) -> kernel.Model:
    """Return the data that do not change while planning. Containers that no robot can reach hold nothing.

    With ``decide_all``, every interaction is a decision; otherwise those that cannot hurt are automatic.

    Raises:
        ValueError: the task has more objects than the kernel's bit masks hold.
    """
    objects = problem.presence_prob.shape[1]
    if objects > MAX_OBJECTS:
        raise ValueError(f"search planners handle tasks of up to {MAX_OBJECTS} objects, this one has {objects}")
    automaton = problem.automaton
    reachable = problem.reach.any(axis=0)
    prob = np.ascontiguousarray(np.clip(problem.presence_prob, MIN_PROB, 1.0 - MIN_PROB))
    prob[~reachable] = 0.0
    return kernel.Model(
        travel_s=ways_s(problem),
        touchable=masks(problem.touchable),
        prob=prob,
        transitions=automaton.transitions.astype(np.int64),
        states=state_records(automaton, problem.obtainable(), decide_all),
        penalty_s=stuck_penalty_s(problem),
        max_decisions=MOVES_PER_EVENT * (len(problem.robots) + 1) * (len(prob) + len(automaton.accepting)),
    )


def ways_s(problem: PlanningProblem) -> Floats:
    """Return the travel times of all kinds of robots, and those of robots on own ways, one below the other."""
    return np.concatenate(_ways_and_rows(problem)[0]).astype(np.float64)


def _ways_and_rows(problem: PlanningProblem) -> tuple[list[Floats], list[int]]:
    """Return travel times [C, C], and each robot's first row in them, one below the other.

    These are the kinds' times. A robot that only its own ways lead from where it stands has a table of its own.
    """
    ways = [kind.travel_s for kind in problem.kinds]
    tables = []
    for robot in problem.robots:
        tables.append(robot.kind)
        if problem.on_own_ways(robot):
            own = ways[robot.kind].copy()
            own[robot.place] = robot.travel_s
            tables[-1] = len(ways)
            ways.append(own)
    return ways, [table * len(problem.searched) for table in tables]


def kind_fields(problem: PlanningProblem) -> dict[str, ArrayLike]:
    """Return what robots' records say of their kinds, each [R]: the first row in `ways_s`, and the times."""
    kinds = [problem.kinds[robot.kind] for robot in problem.robots]
    return {
        "rows": _ways_and_rows(problem)[1],
        "search_time_s": [kind.search_time_s for kind in kinds],
        "interact_time_s": [kind.interact_time_s for kind in kinds],
    }


def stuck_penalty_s(problem: PlanningProblem) -> float:
    """Return the extra cost of a sample that cannot finish: at least the time to visit all containers one by one."""
    times_s = np.concatenate([ways_s(problem), [robot.travel_s for robot in problem.robots]])
    longest_s = times_s[np.isfinite(times_s)].max(initial=1.0)
    searching_s = max(problem.kinds[robot.kind].search_time_s for robot in problem.robots)
    return float(len(problem.searched) * (longest_s + searching_s))


def root_world(problem: PlanningProblem, model: kernel.Model, reassign_all: bool) -> kernel.World:
    """Return the team's present state; ``reassign_all`` lets robots under way decide where the problem allows it."""
    root = blank_world(problem)
    root.containers.searched[:] = problem.searched
    known = (problem.presence_prob > 0) & problem.searched[:, None]
    root.containers.holds[:] = masks(known & problem.touchable)
    root.nowhere[:] = np.prod(np.where(problem.searched[:, None], 1.0, 1.0 - model.prob), axis=0)
    root.state[AUTOMATON] = problem.state
    root.state[kernel.FOUND] = np.bitwise_or.reduce(root.containers.holds)
    root.state[kernel.SEEN] = np.bitwise_or.reduce(masks(known))
    for index, robot in enumerate(problem.robots):
        record = root.robots[index]
        record.place, record.want, record.until_s = robot.place, NONE, np.inf
        record.origin = NONE if robot.place < 0 else record.rows + robot.place
        if robot.interaction >= 0:
            record.want = robot.interaction
        root.away[index] = robot.travel_s
        if robot.free:
            record.undecided = 1
            continue
        record.until_s = robot.remaining_s
        if robot.target >= 0:
            record.mode, record.place, record.origin = kernel.MOVING, robot.target, NONE
        else:
            record.mode = kernel.SEARCHING if robot.interacting < 0 else kernel.INTERACTING
            record.doing = robot.interacting
        root.containers[record.place].targeted += 1
        if reassign_all and problem.may_redirect and robot.target >= 0:
            kernel.reconsider(root, index)
    return root


def blank_world(problem: PlanningProblem) -> kernel.World:
    """Return a world of the problem's size, to be overwritten."""
    containers, objects = problem.presence_prob.shape
    robots = len(problem.robots)
    return kernel.World(
        clock=np.zeros(1),
        state=np.zeros(5, dtype=np.int64),
        containers=blank_records(containers, kernel.CONTAINER),
        nowhere=np.ones(objects),
        robots=blank_records(
            robots,
            kernel.ROBOT,
            until_s=np.inf,
            place=NONE,
            want=NONE,
            doing=NONE,
            origin=NONE,
            handles=masks(problem.handles),
            **kind_fields(problem),
        ),
        away=np.zeros((robots, containers)),
    )


def blank_records(count: int, dtype: np.dtype[np.void], **values: ArrayLike) -> Records:
    """Return ``count`` records whose fields are 0, except for the given values, one for all or one each."""
    records = np.zeros(count, dtype=dtype).view(np.recarray)
    for name, value in values.items():
        records[name] = value
    return records


def state_records(automaton: Automaton, available: Bools, decide_all: bool = False) -> Records:
    """Return the task's states [Z] as kernels know them, if only the ``available`` [O] objects will be found."""
    records = blank_records(len(automaton.accepting), STATE)
    steps, harmless = automaton.steps_with(available), safe(automaton)
    nearer = automaton.advancing & (harmless | (steps[automaton.transitions] < steps[:, None]))
    records.advancing[:] = masks(automaton.advancing)
    records.worth[:] = masks(nearer | worth_interacting(automaton, automaton.advancing & ~nearer, available))
    records.nearer[:] = masks(nearer)
    records.safe[:] = masks(harmless)
    records.automatic[:] = 0 if decide_all else records.safe
    records.needed[:] = masks(needed(automaton))
    records.steps[:] = steps
    records.accepting[:] = automaton.accepting
    return records


def assignment_begun(world: kernel.World, robot: int, unnamed: int = ANY_SAFE) -> Assignment:
    """Return, as an assignment, the action that `team_kernel.act` has just begun for a robot.

    ``unnamed`` is the interaction of actions that name none.
    """
    if world.robots[robot].mode != kernel.MOVING:
        return Assignment(WAIT, unnamed)
    want = int(world.robots[robot].want)
    return Assignment(int(world.robots[robot].place), unnamed if want == NONE else want)


def masks(members: np.ndarray) -> Ints:
    """Return the bit masks [N] of the rows of a boolean array [N, O]."""
    result: Ints = (members.astype(np.int64) << np.arange(members.shape[1])).sum(axis=1)
    return result
