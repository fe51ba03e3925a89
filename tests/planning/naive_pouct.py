"""`pouct` in plain Python: what its kernels must equal sample by sample, given the same random numbers.

How a team's actions unfold is taken from the exact solver, with contents drawn instead of enumerated. The greedy policy
looks at every pair of robot and action again whenever it chooses; the tree is made of objects.
"""

from dataclasses import dataclass, field
from math import inf, log, prod, sqrt

import numpy as np

from mrtask.planning.pouct import LEAST_VISITS
from mrtask.planning.pouct_kernel import TIE_S
from tests.planning.exact_solver import WAIT, ExactSolver
from tests.planning.naive_random import SplitMix64


@dataclass
class Node:
    robot: int
    visits: int = 0
    edges: list = field(default_factory=list)
    passed: float = 0.0  # visits times the mean cost of the most visited edge

    def value(self):
        """The mean cost of the most visited edge."""
        return min(self.edges, key=lambda edge: (-len(edge.costs), edge.mean)).mean


@dataclass
class Edge:
    action: object  # container, WAIT or (container, object): see `NaivePouct.resolve`
    costs: list = field(default_factory=list)  # of all samples
    total: float = 0.0  # of the costs, as if samples through a child had taken the child's most visited edge
    children: dict = field(default_factory=dict)

    @property
    def mean(self):
        return self.total / len(self.costs)


def worth_doing(problem):
    """For each state the objects that are safe or bring acceptance nearer; and with them those after which it can be
    reached without the state. Letters are the objects that were found, or all while something is left to search."""
    automaton = problem.automaton
    reach = np.isfinite([robot.travel_s for robot in problem.robots]).any(axis=0)
    left = (reach & ~problem.searched).any()
    letters = [
        o for o in range(len(automaton.propositions)) if left or any(problem.holds(c, o) for c in range(len(reach)))
    ]

    def steps(z, without=None):
        front, seen, count = {z}, {z, without}, 0
        while front and not any(automaton.accepting[one] for one in front):
            front = {int(automaton.transitions[one, o]) for one in front for o in letters} - seen
            seen |= front
            count += 1
        return count if front else inf

    nearer, worth = [], []
    for z, row in enumerate(automaton.advancing):
        after = {o: int(automaton.transitions[z, o]) for o in np.flatnonzero(row)}
        nearer.append({o for o, to in after.items() if automaton.includes[to, z] or steps(to) < steps(z)})
        worth.append(nearer[z] | {o for o, to in after.items() if o in letters and steps(to, without=z) < inf})
    return nearer, worth


class NaivePouct(ExactSolver):
    def __init__(self, problem, prob, seed, options, decide_all=None):
        super().__init__(problem, prob, options.reassign == "all", decide_all)
        self.random = SplitMix64(seed)
        self.options = options
        self.costs, self.spreads, self.spread = [], [0.0], 1.0
        self.most = min(options.samples + 1, options.max_nodes)  # nodes, and as many edges
        self.nodes, self.edges = 1, 0
        self.nearer, self.worth = worth_doing(problem)
        self.tree = Node(self.first_to_decide(self.root))

    def run(self, samples):
        for _ in range(samples):
            self.sample()
        return self.tree

    def sample(self):
        state, node, path, at_root = self.root, self.tree, [], True
        while True:
            edge = self.select(state, node, at_root)
            node.visits += 1
            if edge is None:
                state = self.rollout(state)
                break
            path.append((node, edge))
            before = state
            state = self._act(state, node.robot, self.resolve(state, node.robot, edge.action))
            observed = None
            if not state.undecided:
                state, done = self.unfold(state)
                at_root = False
                observed = tuple(after for now, after in zip(before.held, state.held, strict=True) if now is None)
                if done:
                    break
            if observed not in edge.children:
                if self.nodes < self.most:
                    edge.children[observed] = Node(self.first_to_decide(state))
                    self.nodes += 1
                state = self.rollout(state)
                break
            node = edge.children[observed]
        cost = state.clock
        self.costs.append(cost)
        if len(self.costs) > 1:
            self.spreads.append(float(np.std(self.costs)))
            self.spread = max(self.spreads)
        gained = cost
        for at, edge in reversed(path):
            edge.costs.append(cost)
            edge.total += gained
            passed = at.visits * at.value()
            gained, at.passed = passed - at.passed, passed

    def select(self, state, node, at_root):
        options = self.options
        if not node.edges or len(node.edges) < options.widening_factor * node.visits**options.widening_exponent:
            action = self.next_action(state, node)
            if action is not None and self.edges < self.most:
                self.edges += 1
                node.edges.append(Edge(action))
                return node.edges[-1]

        least = min(reversed(node.edges), key=lambda edge: len(edge.costs), default=None)
        if at_root and least is not None and len(least.costs) < LEAST_VISITS * sqrt(node.visits):
            return least

        def bound(edge):
            return edge.mean - options.exploration * self.spread * sqrt(log(node.visits + 1) / len(edge.costs))

        best, least = None, inf
        for edge in reversed(node.edges):
            if bound(edge) < least - TIE_S:
                best, least = edge, bound(edge)
        return best

    def next_action(self, state, node):
        tried = {edge.action for edge in node.edges}
        wait_now = WAIT not in tried and any(
            index in state.undecided or robot.action is not None
            for index, robot in enumerate(state.robots)
            if index != node.robot
        )
        if wait_now and len(tried) >= 2:
            return WAIT
        fetched = self.being_fetched(state)
        for fetching, ahead in ((fetched, self.nothing_left(state, fetched)), (frozenset(), True)):
            action, _ = self.best(state, node.robot, fetching, ahead, tried, self.worth)
            if action is not None:
                return action
        return WAIT if wait_now or not tried else None

    def rollout(self, state):
        for _ in range(4 * (len(state.robots) + 1) * (len(state.held) + len(self.accepting))):
            while state.undecided:
                robot, action = self.greedy(state)
                state = self._act(state, robot, self.resolve(state, robot, action))
            state, done = self.unfold(state)
            if done:
                return state
        raise AssertionError(f"a roll-out of {self.problem.automaton.formula} goes round in circles")

    def first_to_decide(self, state):
        return self.greedy(state)[0]

    def greedy(self, state):
        """The robot and action of least score over all; waiting where nothing is of use."""
        fetching = self.being_fetched(state)
        ahead = self.nothing_left(state, fetching)
        scored = [(r, *self.best(state, r, fetching, ahead, (), self.nearer)) for r in sorted(state.undecided)]
        robot, action, _ = min(scored, key=lambda choice: choice[2])
        return robot, WAIT if action is None else action

    def best(self, state, r, fetching, ahead, tried, allowed):
        """(action, score) of the least score among the actions not tried, or (None, inf) if all were tried."""
        scored = []
        for early in (ahead,) if ahead else (False, True):
            for c in range(len(state.held)):
                score = self.score(state, r, c, fetching, early)
                if c not in tried and score < inf:
                    scored.append((score, c))
            if scored:
                break
        for o in sorted((allowed[state.z] - self.safe[state.z]) & state.found - fetching):
            distance = self._distance(state, r, self.nearest_holding(state, r, o))
            if allowed is self.nearer and self.disturbed(state, o):
                continue
            if ("named", o) not in tried and distance < inf:
                factor = 1.0 if o in self.nearer[state.z] else 1e3
                scored.append((max(distance, 1e-9) * factor, ("named", o)))
        score, action = min(scored, key=lambda entry: entry[0], default=(inf, None))
        return action, score

    def disturbed(self, state, o):
        """Whether an interaction under way, which comes first, is one that may hurt or leaves nothing to gain by o."""
        for index, robot in enumerate(state.robots):
            other = None
            if robot.busy not in (None, "search"):
                other = robot.busy
            elif robot.action is not None and robot.moving and index not in state.undecided:
                other = robot.action[1]
            if other in self.advancing[state.z]:
                after = int(self.delta[state.z, other])
                if other not in self.harmless[state.z] or o not in self.nearer[after]:
                    return True
        return False

    def score(self, state, r, c, fetching, early):
        if any(
            i not in state.undecided and x.action is not None and x.action[0] == c for i, x in enumerate(state.robots)
        ):
            return inf
        needed, nearer = self.needed[state.z], self.nearer[state.z]
        distance = max(self._distance(state, r, c), 1e-9)
        if state.held[c] is None:
            weights = {o: 1.0 if o in nearer else self.options.later_weight for o in needed - state.found}
            helps = 1 - prod(1 - weight * self.prob[c][o] for o, weight in weights.items())
            return distance / helps if helps > 0 else inf
        useful = state.held[c] & needed
        if useful & self.safe[state.z] - fetching:
            return distance
        if early and useful - nearer and not self.stands_ready(state, r):
            return distance / self.options.later_weight
        return inf

    def being_fetched(self, state):
        """Objects that robots are busy with, or on their way to, where they are known to be."""
        mask = frozenset()
        for index, robot in enumerate(state.robots):
            if robot.action is None:
                continue
            if robot.busy not in (None, "search"):
                mask |= {robot.busy}
            elif robot.moving and index not in state.undecided:
                mask |= state.held[robot.action[0]] or frozenset()
        return mask

    def nothing_left(self, state, fetching):
        return self.nearer[state.z] <= fetching

    def stands_ready(self, state, r):
        robot = state.robots[r]
        if robot.moving or robot.place is None or state.held[robot.place] is None:
            return False
        return bool(state.held[robot.place] & self.needed[state.z] - self.nearer[state.z])

    def nearest_holding(self, state, r, o):
        places = [c for c, held in enumerate(state.held) if held and o in held]
        return min(places, key=lambda c: self._distance(state, r, c))

    def resolve(self, state, r, action):
        """An action in the exact solver's terms: ("named", object) becomes (nearest place, object)."""
        return (self.nearest_holding(state, r, action[1]), action[1]) if isinstance(action, tuple) else action

    def unfold(self, state):
        """(state, done) at the next decision instant, contents drawn."""
        done = False
        while not (done or state.undecided):
            [(_, state, done)] = self._advance(state, freed=False, news=False)
        return state, done

    def _contents(self, state, container):
        """One draw in place of the distribution: per object, in order, given that it exists somewhere."""
        held = set()
        for o in sorted(self.needed[state.z]):
            exists = 1.0
            if o not in state.found:
                exists -= prod(1 - self.prob[c][o] for c, seen in enumerate(state.held) if seen is None)
            if self.random.unit() * exists < self.prob[container][o]:
                held.add(o)
        yield 1.0, frozenset(held)
