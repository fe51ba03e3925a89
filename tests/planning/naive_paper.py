"""The search of `pouct_paper` in plain Python: the twin of `mrtask.planning.paper.search_kernel`.

Beliefs are dictionaries and lists, the tree is made of objects, and random numbers come from `naive_random`. Sums are
added up in the kernel's order, so that results are equal to the last bit.
"""

import math
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from mrtask.planning.pouct import PouctOptions
from mrtask.planning.team_model import team_model
from tests.planning.exact_solver import Robot as SolverRobot
from tests.planning.exact_solver import State
from tests.planning.naive_pouct import NaivePouct, worth_doing
from tests.planning.naive_random import SplitMix64

WAIT = -1


@dataclass
class Robot:
    """``place`` is None at a place of its own, ``away_s`` from the containers; ``obj`` None while the robot is free or
    waits.

    A robot that left ``origin`` (None: a place of its own) at ``since_s`` is at its container at ``reach_s``; one that
    decides anew on the way is ``under_way``.
    """

    place: int | None
    away_s: list
    obj: int | None = None
    arrive_s: float = 0.0
    done_s: float = 0.0
    undecided: bool = False
    under_way: bool = False
    origin: int | None = None
    since_s: float = 0.0
    reach_s: float = 0.0


@dataclass
class Belief:
    """``known``: for pairs (container, object) that were looked at, whether the object is there.

    ``nowhere``: by object, the product of 1 - p over the containers where that is not known.
    """

    z: int
    known: dict
    searched: set
    robots: list
    nowhere: list
    clock_s: float = 0.0
    news: bool = False

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
    """``run(samples)`` grows the tree under ``root``: at most ``limit`` nodes, and as many edges."""

    def __init__(self, problem, options, seed=0):
        self.options, self.problem = options, problem
        automaton = problem.automaton
        self.delta, self.accepting = automaton.transitions.tolist(), automaton.accepting.tolist()
        self.containers, self.objects = map(range, problem.presence_prob.shape)
        self.advancing = [{o for o in self.objects if automaton.advancing[z, o]} for z in range(len(self.delta))]
        self.worth = worth_doing(problem)[1]
        self.needed = [set().union(*map(set, self._ways(z))) for z in range(len(self.delta))]
        self.sufficient = [self._minimal(z) for z in range(len(self.delta))]
        self.travel_s = problem.travel_s.tolist()
        self.prob = self._likelihoods(problem)
        self.search_s, self.interact_s = problem.search_time_s, problem.interact_time_s
        ways_s = self.travel_s + [robot.travel_s.tolist() for robot in problem.robots]
        finite_s = [s for row in ways_s for s in row if s < math.inf]
        self.penalty_s = len(self.containers) * (max([1.0, *finite_s]) + self.search_s)
        self.limit, self.random = min(options.samples + 1, options.max_nodes), SplitMix64(seed)
        self.start = self._start(problem)
        self.rollouts = NaiveRollouts(self) if options.leaf == "greedy" else None
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
        prob = [
            [0.0 if seen else self._rounded(p) for p in row]
            for row, seen in zip(problem.presence_prob.tolist(), problem.searched, strict=True)
        ]
        for c in self.containers:
            if all(robot.travel_s[c] == math.inf for robot in problem.robots):
                prob[c] = [0.0 for _ in prob[c]]
        places = [c for c in self.containers if any(robot.travel_s[c] < math.inf for robot in problem.robots)]
        for o in self.objects:
            held = any(problem.presence_prob[c, o] > 0 for c in self.containers if problem.searched[c])
            if not held and all(prob[c][o] == 0 for c in places):
                for c in places:
                    prob[c][o] = 0.0 if problem.searched[c] else 1e-6
        return prob

    def _rounded(self, p):
        decimals = self.options.round_decimals
        return p if decimals is None or p == 0 else max(float(np.round(p, decimals)), 1e-6)

    def _start(self, problem):
        searched = {c for c in self.containers if problem.searched[c]}
        known = {(c, o): bool(problem.presence_prob[c, o] > 0) for c in searched for o in self.objects}
        robots = []
        for status in problem.robots:
            robot = Robot(status.place if status.place >= 0 else None, status.travel_s.tolist(), undecided=status.free)
            robot.origin = robot.place
            if not status.free:
                robot.obj = status.interaction if status.interaction >= 0 else min(self.needed[problem.state])
                robot.arrive_s = status.remaining_s
                if status.target >= 0:
                    robot.place, robot.origin, robot.reach_s = status.target, None, status.remaining_s
                    robot.arrive_s += 0.0 if status.target in searched else self.search_s
                elif status.interacting >= 0:
                    robot.obj = status.interacting
                    robot.arrive_s -= self.interact_s
                robot.done_s = robot.arrive_s + self.interact_s
                if self.options.reassign == "all" and problem.may_redirect and status.target >= 0:
                    robot.obj, robot.undecided, robot.under_way = None, True, True
            robots.append(robot)
        nowhere = [math.prod(1.0 - self.prob[c][o] for c in self.containers) for o in self.objects]
        return Belief(problem.state, known, searched, robots, nowhere)

    def distance_s(self, belief, r, c):
        robot = belief.robots[r]
        if not robot.under_way:
            return robot.away_s[c] if robot.place is None else self.travel_s[robot.place][c]
        start_s = robot.away_s[c] if robot.origin is None else self.travel_s[robot.origin][c]
        ahead_s = robot.reach_s - belief.clock_s + self.travel_s[robot.place][c]
        return min(ahead_s, belief.clock_s - robot.since_s + start_s)

    def p_s(self, belief, pair):
        """The probability that an object is in a container, given what is known."""
        c, o = pair
        if pair in belief.known:
            return float(belief.known[pair])
        if self.options.exists and o not in belief.located() and belief.nowhere[o] < 1:
            return min(self.prob[c][o] / (1 - belief.nowhere[o]), 1.0)
        return self.prob[c][o]

    def stands_ready(self, belief, r):
        """Whether a robot is where an object is whose turn comes later."""
        robot = belief.robots[r]
        later = self.needed[belief.z] - self.worth[belief.z]
        return not robot.under_way and any(belief.known.get((robot.place, o)) for o in later)

    def allowed(self, belief, r):
        """The pairs (container, object) that make progress for robot ``r``, in the order in which they are tried."""
        now, located = self.worth[belief.z], belief.located()
        taken = {(robot.place, robot.obj) for robot in belief.robots if robot.obj is not None}
        result = []
        for c in self.containers:
            for o in self.objects:
                there = belief.known.get((c, o))
                if o not in self.needed[belief.z] or (c, o) in taken or self.distance_s(belief, r, c) == math.inf:
                    continue
                if there is False or (there is None and (o in located or self.prob[c][o] == 0)):
                    continue
                if o not in now and (now - located or (there and self.stands_ready(belief, r))):
                    continue
                result.append((c, o))
        return result

    def actions(self, belief, r):
        """What the options leave of them."""
        options, pairs = self.options, self.allowed(belief, r)
        others = [robot for index, robot in enumerate(belief.robots) if index != r]
        busy = [robot for robot in others if robot.undecided or robot.obj is not None]
        if options.advance_when_alone and not busy:
            pairs = [(c, o) for c, o in pairs if o in self.worth[belief.z]] or pairs
        if options.avoid_targets and others and len(pairs) >= len(belief.robots):
            headed_for = {robot.place for robot in others if robot.obj is not None}
            pairs = [(c, o) for c, o in pairs if c not in headed_for] or pairs
        if options.max_actions is not None:
            likeliest = sorted(pairs, key=lambda pair: -self.p_s(belief, pair))[: options.max_actions]
            pairs = [pair for pair in pairs if pair in likeliest]
        return pairs

    def may_wait(self, belief, r):
        others = [robot for index, robot in enumerate(belief.robots) if index != r]
        return any(robot.undecided or robot.obj is not None for robot in others)

    def act(self, belief, r, action):
        robot = belief.robots[r]
        robot.undecided = False
        goes_on = robot.under_way and action != WAIT and action[0] == robot.place
        if robot.under_way and not goes_on:
            robot.away_s = [self.distance_s(belief, r, c) for c in self.containers]
            robot.place = robot.origin = None
        robot.under_way = False
        if action == WAIT:
            robot.obj = None
            return
        c, robot.obj = action
        if not goes_on:
            robot.reach_s = belief.clock_s + self.distance_s(belief, r, c)
            robot.origin, robot.since_s = robot.place, belief.clock_s
        robot.arrive_s = robot.reach_s
        if c not in belief.searched:
            robot.arrive_s += self.search_s
        robot.done_s = robot.arrive_s + self.interact_s
        robot.place = c

    def advance(self, belief):
        """Draws an outcome of Algorithm 1: (robot, whether it found its object), or None if nobody acts."""
        now = self.advancing[belief.z]
        belief.news = False
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
                    belief.news = True
            else:
                belief.searched.add(robot.place)
                if pair not in belief.known:
                    belief.known[pair] = self.random.unit() < self.p_s(belief, pair)
                    belief.news = True
                    if not belief.known[pair]:
                        left = belief.nowhere[robot.obj] / (1.0 - self.prob[robot.place][robot.obj])
                        belief.nowhere[robot.obj] = min(left, 1.0)
                if belief.known[pair]:
                    continue
            belief.clock_s = max(belief.clock_s, event_s)
            robot.obj = None
            return r, success
        return None

    def put_up(self, belief):
        """Who decides after an outcome."""
        for robot in belief.robots:
            on_the_way = robot.obj is not None and robot.reach_s > belief.clock_s + 1e-9
            if self.options.reassign == "all" and belief.news and on_the_way:
                robot.obj, robot.under_way = None, True
            robot.undecided = robot.undecided or robot.obj is None

    def rest_s(self, belief):
        """What the rest of the task is worth."""
        if self.options.leaf == "zero":
            return 0.0
        return self.rollouts.rest_s(belief) if self.rollouts else self.bound_s(belief)

    def bound_s(self, belief):
        if self.accepting[belief.z]:
            return 0.0
        nearest_s = {
            c: min(
                (0.0 if robot.obj is None else max(robot.arrive_s - belief.clock_s, 0.0))
                + self.distance_s(belief, r, c)
                for r, robot in enumerate(belief.robots)
            )
            for c in self.containers
        }
        begun = {
            robot.obj: max(robot.done_s - belief.clock_s, 0.0)
            for robot in sorted(belief.robots, key=lambda robot: -robot.done_s)
            if robot.obj is not None and robot.arrive_s <= belief.clock_s and belief.known.get((robot.place, robot.obj))
        }
        rest_s = [self._fetch_s(belief, obj, nearest_s) + self.interact_s for obj in self.objects]
        for obj, left_s in begun.items():
            rest_s[obj] = min(rest_s[obj], left_s)

        def takes_s(members):
            rounds = math.ceil(len(members - begun.keys()) / len(belief.robots))
            return max(max(rest_s[obj] for obj in members), rounds * self.interact_s)

        best_s = min(map(takes_s, self.sufficient[belief.z]), default=math.inf)
        return best_s if best_s < math.inf else self.penalty_s

    def _fetch_s(self, belief, obj, nearest_s):
        """To the nearest container that holds the object, given that one in reach does; or that may hold it."""
        nowhere, sum_s = 1.0, 0.0
        for c in sorted(self.containers, key=nearest_s.get):
            if nowhere < 1e-12 or nearest_s[c] == math.inf:
                break
            there = belief.known.get((c, obj), self.prob[c][obj])
            if self.options.leaf == "nearest" and there > 0:
                there = 1.0
            sum_s += nowhere * there * nearest_s[c]
            nowhere *= 1.0 - there
        return sum_s / (1.0 - nowhere) if nowhere < 1.0 else math.inf

    def run(self, samples):
        for _ in range(samples):
            scale_s = self.spread_s if self.count > 1 else 1.0
            if self.options.exploration_unit == "seconds":
                scale_s = 1.0
            path, cost_s = self._sample(self.options.exploration * scale_s)
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
                return path, belief.clock_s + self.rest_s(belief)
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
                self.put_up(belief)
            known_child = [child for child in edge.children if child.label == label]
            if not known_child:
                if self.nodes < self.limit:
                    edge.children.append(self._new_node(belief, label))
                return path, belief.clock_s + self.rest_s(belief)
            node = known_child[0]

    def _seen(self, belief):
        """What is known of the pairs that robots act on: None, False or True for each such robot."""
        return tuple(belief.known.get((robot.place, robot.obj)) for robot in belief.robots if robot.obj is not None)

    def _new_node(self, belief, label):
        self.nodes += 1
        robot = min(belief.undecided())
        actions = self.actions(belief, robot)
        if not actions or self.may_wait(belief, robot):
            actions.append(WAIT)
        return Node(robot, label, actions)

    def _select(self, node, exploration_s):
        if node.untried and self.edges < self.limit:
            self.edges += 1
            node.edges.append(Edge(node.untried.pop(0)))
            return node.edges[-1]
        radius_s = exploration_s * math.sqrt(math.log(node.visits + 1.0))

        def bound_s(edge):
            return edge.total_s / edge.tries - radius_s * (1.0 / math.sqrt(edge.tries))

        return min(reversed(node.edges), key=bound_s, default=None)


class NaiveRollouts:
    """Leaf values by `NaivePouct`'s greedy rollout, in a world drawn from the belief."""

    def __init__(self, search):
        self.search = search
        self.twin = NaivePouct(search.problem, team_model(search.problem).prob, 0, PouctOptions(), decide_all=False)
        self.twin.random = search.random

    def rest_s(self, belief):
        """How long the team takes from a belief; the penalty on top if it cannot finish."""
        state, done = self.world(belief), False
        while not done:
            while state.undecided:
                robot, action = self.twin.greedy(state)
                state = self.twin._act(state, robot, self.twin.resolve(state, robot, action))
            before_s = state.clock
            state, done = self.twin.unfold(state)
        return (before_s + self.search.penalty_s if state.clock == math.inf else state.clock) - belief.clock_s

    def world(self, belief):
        held = self.contents(belief)
        robots = tuple(self.robot(belief, r, held) for r in range(len(belief.robots)))
        return State(belief.clock_s, belief.z, held, robots, frozenset(belief.undecided()))

    def contents(self, belief):
        """What is in each searched container: what is not known of it is drawn; None for the others."""
        located, needed = belief.located(), sorted(self.twin.needed[belief.z])
        unknown = {(c, o) for c in self.search.containers for o in self.search.objects} - belief.known.keys()
        held = []
        for c in self.search.containers:
            there = {o for o in self.search.objects if belief.known.get((c, o))}
            if c not in belief.searched:
                held.append(None)
                continue
            for o in needed:
                if (c, o) in unknown:
                    exists = 1.0
                    if o not in located:
                        exists -= math.prod(1 - self.twin.prob[k][o] for k, other in sorted(unknown) if other == o)
                    if self.search.random.unit() * exists < self.twin.prob[c][o]:
                        there.add(o)
                        located.add(o)
                    unknown.remove((c, o))
            held.append(frozenset(there))
        return tuple(held)

    def robot(self, belief, r, held):
        """A robot in the terms of `ExactSolver`."""
        robot, travel_s = belief.robots[r], self.search.travel_s
        if robot.obj is None and not robot.under_way:
            return SolverRobot(tuple(self.search.distance_s(belief, r, c) for c in self.search.containers), robot.place)
        advances = robot.obj in self.twin.advancing[belief.z]
        named = robot.obj if advances and robot.obj not in self.twin.safe[belief.z] else None
        departed = tuple(robot.away_s if robot.origin is None else travel_s[robot.origin])
        moving = SolverRobot(departed, None, (robot.place, named), None, robot.since_s, robot.reach_s)
        here = SolverRobot(tuple(travel_s[robot.place]), robot.place, (robot.place, named), "search")
        if robot.under_way or robot.reach_s > belief.clock_s:
            return moving
        if held[robot.place] is None or robot.arrive_s > belief.clock_s:
            return replace(here, until=max(robot.arrive_s, belief.clock_s))
        if advances and robot.obj in held[robot.place] and belief.known.get((robot.place, robot.obj)):
            return replace(here, busy=robot.obj, until=max(robot.done_s, belief.clock_s))
        return replace(moving, until=belief.clock_s)
