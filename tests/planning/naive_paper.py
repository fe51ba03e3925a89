"""The search of `pouct_paper` in plain Python: the twin of `mrtask.planning.paper_kernel`.

Beliefs are dictionaries and lists, the tree is made of objects, and random numbers come from `naive_random`. Sums are
added up in the kernel's order, so that results are equal to the last bit.
"""

import math
from copy import deepcopy
from dataclasses import dataclass, field

from tests.planning.naive_random import SplitMix64

WAIT = -1


@dataclass
class Robot:
    """``place`` is None at the starting place; ``obj`` None while the robot is free or waits."""

    place: int | None
    obj: int | None = None
    arrive_s: float = 0.0
    done_s: float = 0.0
    undecided: bool = False


@dataclass
class Belief:
    """``known``: for pairs (container, object) that were looked at, whether the object is there."""

    z: int
    known: dict
    searched: set
    robots: list
    clock_s: float = 0.0

    def located(self):
        return {obj for (_, obj), there in self.known.items() if there}

    def undecided(self):
        return [index for index, robot in enumerate(self.robots) if robot.undecided]


@dataclass
class Node:
    robot: int
    label: object
    untried: list
    edges: list = field(default_factory=list)
    visits: int = 0


@dataclass
class Edge:
    action: object
    children: list = field(default_factory=list)
    tries: int = 0
    total_s: float = 0.0


class NaivePaperSearch:
    """``run(samples)`` grows the tree under ``root``; at most ``limit`` nodes, and as many edges."""

    def __init__(self, problem, *, exploration=1.0, limit=10**9, seed=0):
        automaton = problem.automaton
        self.delta, self.accepting = automaton.transitions.tolist(), automaton.accepting.tolist()
        self.containers, self.objects = map(range, problem.presence_prob.shape)
        self.advancing = [{o for o in self.objects if automaton.advancing[z, o]} for z in range(len(self.delta))]
        self.needed = [set().union(*map(set, self._ways(z))) for z in range(len(self.delta))]
        self.sufficient = [self._minimal(z) for z in range(len(self.delta))]
        self.travel_s, self.away_s = problem.travel_s.tolist(), [robot.travel_s.tolist() for robot in problem.robots]
        self.prob = self._likelihoods(problem)
        self.search_s, self.interact_s = problem.search_time_s, problem.interact_time_s
        finite_s = [s for row in self.travel_s + self.away_s for s in row if s < math.inf]
        self.penalty_s = len(self.containers) * (max([1.0, *finite_s]) + self.search_s)
        self.exploration, self.limit, self.random = exploration, limit, SplitMix64(seed)
        self.start = self._start(problem)
        self.nodes = self.edges = 0
        self.count, self.mean_s, self.squares, self.spread_s = 0, 0.0, 0.0, 0.0
        self.root = self._new_node(self.start, None)

    def _ways(self, z, seen=()):
        """The sequences of advancing interactions from a state: to acceptance, or to a state passed before."""
        if self.accepting[z]:
            return [()]
        ways = []
        for obj in sorted(self.advancing[z]):
            after = self.delta[z][obj]
            ways += [(obj,)] if after in (*seen, z) else [(obj, *way) for way in self._ways(after, (*seen, z))]
        return ways

    def _minimal(self, z):
        """The least sets of objects of which some order, with repetitions left out, completes the task."""
        complete = set()
        for way in self._ways(z):
            state = z
            for obj in way:
                state = self.delta[state][obj]
            if self.accepting[state]:
                complete.add(frozenset(way))
        return [one for one in complete if not any(other < one for other in complete)]

    def _likelihoods(self, problem):
        """What is nowhere, as far as the likelihoods go, may with little probability be in all places left."""
        prob = problem.presence_prob.tolist()
        places = [c for c in self.containers if any(robot.travel_s[c] < math.inf for robot in problem.robots)]
        for o in self.objects:
            if all(prob[c][o] == 0 for c in places):
                for c in places:
                    prob[c][o] = 0.0 if problem.searched[c] else 1e-6
        return prob

    def _start(self, problem):
        searched = {c for c in self.containers if problem.searched[c]}
        known = {(c, o): bool(problem.presence_prob[c, o] > 0) for c in searched for o in self.objects}
        robots = []
        for status in problem.robots:
            robot = Robot(status.place if status.place >= 0 else None, undecided=status.free)
            if not status.free:
                robot.obj = status.interaction if status.interaction >= 0 else min(self.needed[problem.state])
                robot.arrive_s = status.remaining_s
                if status.target >= 0:
                    robot.place = status.target
                    robot.arrive_s += 0.0 if status.target in searched else self.search_s
                elif status.interacting >= 0:
                    robot.obj = status.interacting
                    robot.arrive_s -= self.interact_s
                robot.done_s = robot.arrive_s + self.interact_s
            robots.append(robot)
        return Belief(problem.state, known, searched, robots)

    def distance_s(self, belief, r, c):
        place = belief.robots[r].place
        return self.away_s[r][c] if place is None else self.travel_s[place][c]

    def allowed(self, belief, r):
        """The pairs (container, object) that robot ``r`` may go for, in the order in which they are tried."""
        now, located = self.advancing[belief.z], belief.located()
        taken = {(robot.place, robot.obj) for robot in belief.robots if robot.obj is not None}
        result = []
        for c in self.containers:
            for o in self.objects:
                there = belief.known.get((c, o))
                if o not in self.needed[belief.z] or (c, o) in taken or self.distance_s(belief, r, c) == math.inf:
                    continue
                if there is False or (there is None and (o in located or self.prob[c][o] == 0)):
                    continue
                if o not in now and (now - located or (there and belief.robots[r].place == c)):
                    continue
                result.append((c, o))
        return result

    def may_wait(self, belief, r):
        others = [robot for index, robot in enumerate(belief.robots) if index != r]
        return any(robot.undecided or robot.obj is not None for robot in others)

    def act(self, belief, r, action):
        robot = belief.robots[r]
        robot.undecided = False
        if action == WAIT:
            robot.obj = None
            return
        c, robot.obj = action
        robot.arrive_s = belief.clock_s + self.distance_s(belief, r, c)
        if c not in belief.searched:
            robot.arrive_s += self.search_s
        robot.done_s = robot.arrive_s + self.interact_s
        robot.place = c

    def advance(self, belief):
        """Draws an outcome of Algorithm 1: (robot, whether it found its object), or None if nobody acts."""
        now = self.advancing[belief.z]
        events = []
        for r, robot in enumerate(belief.robots):
            if robot.obj is not None:
                events.append((robot.arrive_s, r, False))
                events.append((robot.done_s if robot.obj in now else robot.arrive_s, r, True))
        for event_s, r, success in sorted(events):
            robot = belief.robots[r]
            pair = (robot.place, robot.obj)
            if success:
                if robot.obj in now:
                    belief.z = self.delta[belief.z][robot.obj]
            else:
                belief.searched.add(robot.place)
                if pair not in belief.known:
                    belief.known[pair] = self.random.unit() < self.prob[robot.place][robot.obj]
                if belief.known[pair]:
                    continue
            belief.clock_s = max(belief.clock_s, event_s)
            robot.obj = None
            return r, success
        return None

    def lower_bound_s(self, belief):
        if self.accepting[belief.z]:
            return 0.0
        nearest_s = {}
        for c in self.containers:
            nearest_s[c] = min(
                (0.0 if robot.obj is None else max(robot.arrive_s - belief.clock_s, 0.0))
                + self.distance_s(belief, r, c)
                for r, robot in enumerate(belief.robots)
            )
        nearest_first = sorted(self.containers, key=nearest_s.get)
        mean_s = [self._mean_distance_s(belief, obj, nearest_first, nearest_s) for obj in self.objects]
        best_s = min((max(mean_s[obj] for obj in members) for members in self.sufficient[belief.z]), default=math.inf)
        return best_s if best_s < math.inf else self.penalty_s

    def _mean_distance_s(self, belief, obj, nearest_first, nearest_s):
        """To the nearest container that holds the object, given that one in reach does."""
        nowhere, sum_s = 1.0, 0.0
        for c in nearest_first:
            if nowhere < 1e-12 or nearest_s[c] == math.inf:
                break
            there = belief.known.get((c, obj), self.prob[c][obj])
            sum_s += nowhere * there * nearest_s[c]
            nowhere *= 1.0 - there
        return sum_s / (1.0 - nowhere) if nowhere < 1.0 else math.inf

    def run(self, samples):
        for _ in range(samples):
            spread_s = self.spread_s if self.count > 1 else 1.0
            path, cost_s = self._sample(self.exploration * spread_s)
            self._count(cost_s)
            for edge in path:
                edge.tries += 1
                edge.total_s += cost_s

    def _count(self, cost_s):
        """Welford's running moments; ``spread_s`` is the largest standard deviation so far."""
        self.count += 1
        before = cost_s - self.mean_s
        self.mean_s += before / self.count
        self.squares += before * (cost_s - self.mean_s)
        self.spread_s = max(self.spread_s, math.sqrt(self.squares / self.count))

    def _sample(self, exploration_s):
        belief, node, path = deepcopy(self.start), self.root, []
        while True:
            edge = self._select(node, exploration_s)
            node.visits += 1
            if edge is None:
                return path, belief.clock_s + self.lower_bound_s(belief)
            path.append(edge)
            self.act(belief, node.robot, edge.action)
            label = None
            if not belief.undecided():
                freed = self.advance(belief)
                if freed is None:
                    return path, belief.clock_s + self.penalty_s
                if self.accepting[belief.z]:
                    return path, belief.clock_s
                label = (freed, self._seen(belief))
                for robot in belief.robots:
                    robot.undecided = robot.undecided or robot.obj is None
            known_child = [child for child in edge.children if child.label == label]
            if not known_child:
                if self.nodes < self.limit:
                    edge.children.append(self._new_node(belief, label))
                return path, belief.clock_s + self.lower_bound_s(belief)
            node = known_child[0]

    def _seen(self, belief):
        """What is known of the pairs that robots act on: None, False or True for each such robot."""
        return tuple(belief.known.get((robot.place, robot.obj)) for robot in belief.robots if robot.obj is not None)

    def _new_node(self, belief, label):
        self.nodes += 1
        robot = min(belief.undecided())
        actions = self.allowed(belief, robot)
        if not actions or self.may_wait(belief, robot):
            actions.append(WAIT)
        return Node(robot, label, actions)

    def _select(self, node, exploration_s):
        if node.untried and self.edges < self.limit:
            self.edges += 1
            node.edges.append(Edge(node.untried.pop(0)))
            return node.edges[-1]
        log_visits = math.log(node.visits + 1.0)

        def bound_s(edge):
            return edge.total_s / edge.tries - exploration_s * math.sqrt(log_visits / edge.tries)

        return min(reversed(node.edges), key=bound_s, default=None)
