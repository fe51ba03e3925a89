"""A planning problem in the terms of the team's compiled simulation, and back."""

import numpy as np

from mrtask.planning import team_kernel as kernel
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, PlanningProblem, needed, safe

MIN_PROB = 1e-6
"""Likelihoods of 0 and 1 move this far inside: a container that should hold nothing is searched last, not never."""
MAX_OBJECTS = 30


def team_model(problem: PlanningProblem) -> kernel.Model:
    """What does not change while planning; containers out of every robot's reach hold nothing.

    Raises:
        ValueError: more task objects than the kernel's bit masks hold.
    """
    objects = problem.presence_prob.shape[1]
    if objects > MAX_OBJECTS:
        raise ValueError(f"planners by search handle tasks of up to {MAX_OBJECTS} objects, this one has {objects}")
    automaton = problem.automaton
    reachable = np.isfinite(np.array([robot.travel_s for robot in problem.robots])).any(axis=0)
    prob = np.clip(problem.presence_prob, MIN_PROB, 1.0 - MIN_PROB)
    prob[~reachable] = 0.0
    return kernel.Model(
        travel_s=np.ascontiguousarray(problem.travel_s, dtype=np.float64),
        prob=prob,
        transitions=automaton.transitions.astype(np.int32),
        accepting=automaton.accepting.astype(np.uint8),
        advancing=_masks(automaton.advancing),
        safe=_masks(safe(automaton)),
        needed=_masks(needed(automaton)),
        steps=automaton.steps_to_accept.astype(np.int32),
        search_time_s=float(problem.search_time_s),
        interact_time_s=float(problem.interact_time_s),
        penalty_s=stuck_penalty_s(problem),
    )


def stuck_penalty_s(problem: PlanningProblem) -> float:
    """What a sample that cannot finish the task costs more: the time to visit all containers one by one, at least."""
    ways_s = np.concatenate([problem.travel_s, [robot.travel_s for robot in problem.robots]])
    longest_s = ways_s[np.isfinite(ways_s)].max(initial=1.0)
    return float(len(problem.searched) * (longest_s + problem.search_time_s))


def root_world(problem: PlanningProblem, model: kernel.Model, reassign_all: bool) -> kernel.World:
    """The team as it is now; ``reassign_all`` puts robots under way up for decision where the problem allows it."""
    root = blank_world(problem)
    root.searched[:] = problem.searched
    root.holds[:] = np.where(problem.searched, _masks(problem.presence_prob > 0), 0)
    root.nowhere[:] = np.prod(np.where(problem.searched[:, None], 1.0, 1.0 - model.prob), axis=0)
    root.state[kernel.AUTOMATON] = problem.state
    root.state[kernel.FOUND] = np.bitwise_or.reduce(root.holds)
    for index, robot in enumerate(problem.robots):
        root.place[index], root.want[index], root.until_s[index] = robot.place, robot.interaction, np.inf
        root.origin[index] = robot.place
        root.away[index] = robot.travel_s
        if robot.free:
            root.undecided[index] = 1
            continue
        root.until_s[index] = robot.remaining_s
        if robot.target >= 0:
            root.mode[index], root.place[index], root.origin[index] = kernel.MOVING, robot.target, kernel.NONE
        else:
            root.mode[index] = kernel.SEARCHING if robot.interacting < 0 else kernel.INTERACTING
            root.doing[index] = robot.interacting
        root.targeted[root.place[index]] += 1
        if reassign_all and problem.may_redirect and robot.target >= 0:
            kernel.reconsider(root, index)
    return root


def blank_world(problem: PlanningProblem) -> kernel.World:
    """A world of the problem's size, to be overwritten."""
    containers, objects = problem.presence_prob.shape
    robots = len(problem.robots)
    return kernel.World(
        clock=np.zeros(1),
        state=np.zeros(4, dtype=np.int64),
        searched=np.zeros(containers, dtype=np.uint8),
        holds=np.zeros(containers, dtype=np.int64),
        targeted=np.zeros(containers, dtype=np.int32),
        nowhere=np.ones(objects),
        mode=np.full(robots, kernel.FREE, dtype=np.int32),
        place=np.full(robots, kernel.NONE, dtype=np.int32),
        want=np.full(robots, kernel.NONE, dtype=np.int32),
        doing=np.full(robots, kernel.NONE, dtype=np.int32),
        until_s=np.full(robots, np.inf),
        since_s=np.zeros(robots),
        origin=np.full(robots, kernel.NONE, dtype=np.int32),
        away=np.zeros((robots, containers)),
        undecided=np.zeros(robots, dtype=np.uint8),
    )


def assignment_begun(world: kernel.World, robot: int) -> Assignment:
    """What `team_kernel.act` just made of a robot, as an assignment."""
    if world.mode[robot] != kernel.MOVING:
        return Assignment(WAIT)
    want = int(world.want[robot])
    return Assignment(int(world.place[robot]), ANY_SAFE if want == kernel.NONE else want)


def _masks(members: np.ndarray) -> kernel.I8:
    """[N] bit masks of the rows of a boolean [N, O]."""
    result: kernel.I8 = (members.astype(np.int64) << np.arange(members.shape[1])).sum(axis=1)
    return result
