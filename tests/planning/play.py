"""An episode on a planning problem without a home: robots follow travel times, searches reveal the truth."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from mrtask.planning.problem import ANY_SAFE, WAIT, RobotStatus, safe

INSTANT_S = 1e-9


@dataclass
class Robot:
    """``row``: travel times from where it stands or left at ``since_s``; ``doing``: free, move, search or interact."""

    row: np.ndarray
    place: int = -1
    doing: str = "free"
    target: int = -1
    since_s: float = 0.0
    until_s: float = inf
    interaction: int = ANY_SAFE
    interacting: int = -1
    kind: int = 0


@dataclass(frozen=True)
class Played:
    """How it ended: after how many decisions, and the most in a row after which nothing was learned or done."""

    accepted: bool
    decisions: int
    most_idle: int
    cost_s: float


class Play:
    """``run`` plays a problem with free robots to its end; ``truth`` [C, O] says what is where."""

    def __init__(self, problem, truth):
        self.problem, self.truth = problem, truth
        self.state, self.searched, self.clock_s, self.news = problem.state, problem.searched.copy(), 0.0, True
        self.prob = problem.presence_prob.copy()
        self.robots = [Robot(robot.travel_s, robot.place, kind=robot.kind) for robot in problem.robots]

    def run(self, planner, seed=0, limit=200):
        decisions = idle = most_idle = 0
        accepting = self.problem.automaton.accepting
        while not accepting[self.state] and decisions < limit:
            before = self.state, self.searched.sum()
            plan = planner.plan(self.view(), seed + decisions)
            decisions += 1
            self.news = False
            for index, assignment in plan.assignments.items():
                self.start(self.robots[index], assignment)
            if not self.advance():
                break
            idle = idle + 1 if before == (self.state, self.searched.sum()) else 0
            most_idle = max(most_idle, idle)
        return Played(bool(accepting[self.state]), decisions, most_idle, self.clock_s)

    def view(self):
        robots = tuple(
            RobotStatus(
                self.ways_s(robot),
                place=robot.place if robot.doing != "move" else -1,
                free=robot.doing == "free",
                target=robot.target if robot.doing == "move" else -1,
                interaction=robot.interaction,
                remaining_s=0.0 if robot.doing == "free" else robot.until_s - self.clock_s,
                interacting=robot.interacting if robot.doing == "interact" else -1,
                kind=robot.kind,
            )
            for robot in self.robots
        )
        return replace(
            self.problem,
            state=self.state,
            presence_prob=self.prob.copy(),
            searched=self.searched.copy(),
            robots=robots,
            may_redirect=self.news,
        )

    def ways_s(self, robot):
        if robot.doing != "move":
            return robot.row
        ahead_s = robot.until_s - self.clock_s + self.problem.kinds[robot.kind].travel_s[robot.target]
        return np.minimum(ahead_s, self.clock_s - robot.since_s + robot.row)

    def start(self, robot, assignment):
        if robot.doing == "move" and assignment.container == robot.target:
            robot.interaction = assignment.interaction
            return
        if robot.doing == "move":
            robot.row, robot.place = self.ways_s(robot), -1
        robot.doing, robot.until_s, robot.interaction = "free", inf, assignment.interaction
        if assignment.container != WAIT:
            robot.doing, robot.target, robot.since_s = "move", assignment.container, self.clock_s
            robot.until_s = self.clock_s + robot.row[assignment.container]

    def advance(self):
        """Until a robot is free or the task is done; False if nobody does anything."""
        freed = False
        while not self.problem.automaton.accepting[self.state]:
            robot = min(self.robots, key=lambda robot: robot.until_s)
            if robot.until_s == inf or (freed and robot.until_s > self.clock_s + INSTANT_S):
                return freed
            self.clock_s = max(self.clock_s, robot.until_s)
            freed = self.finish(robot) or freed
        return True

    def finish(self, robot):
        """A robot has arrived, searched or interacted: whether that frees it."""
        kind = self.problem.kinds[robot.kind]
        if robot.doing == "move":
            robot.place, robot.row = robot.target, kind.travel_s[robot.target]
            if not self.searched[robot.place]:
                robot.doing, robot.until_s = "search", self.clock_s + kind.search_time_s
                return False
        elif robot.doing == "search":
            self.news |= not self.searched[robot.place]
            self.searched[robot.place] = True
            self.prob[robot.place] = self.truth[robot.place]
        elif self.problem.automaton.advancing[self.state, robot.interacting]:
            self.state, self.news = int(self.problem.automaton.transitions[self.state, robot.interacting]), True
        if robot.doing != "interact" or robot.interaction == ANY_SAFE:
            automaton = self.problem.automaton
            allowed = safe(automaton) if robot.interaction == ANY_SAFE else automaton.advancing
            touched = np.ones(self.truth.shape[1], dtype=bool) if kind.handles is None else kind.handles
            here = np.flatnonzero(allowed[self.state] & self.truth[robot.place] & touched)
            chosen = [obj for obj in here if robot.interaction in (ANY_SAFE, obj)]
            if chosen:
                robot.doing, robot.interacting = "interact", int(chosen[0])
                robot.until_s = self.clock_s + kind.interact_time_s
                return False
        robot.doing, robot.until_s = "free", inf
        return True
