"""The optimum of the decision problem that `pouct_paper` samples, by expectimax over team beliefs in plain Python.

It shares no code with the kernel. Every action <container, object> that the planner's tree allows is tried, for the
free robots one after the other; the outcomes up to the next free robot come from playing every possible content of the
pairs acted on, not from walking events. Times are relative to the present, so that equal situations are solved once.

A robot may walk to and fro between objects whose turn has not come, for as long as it likes: every value is therefore
sought below a bound only, and a way that costs the bound anyhow is left.
"""

from itertools import product
from math import inf, prod
from typing import NamedTuple

WAIT = -1
DIGITS = 9
"""Relative times are rounded to nanoseconds: ties stay ties, and equal situations equal."""


class Acting(NamedTuple):
    """A robot on its way to look for an object, or interacting with it: times from now, the first past once found."""

    container: int
    obj: int
    arrives_s: float
    done_s: float


class Team(NamedTuple):
    """``places``: where each robot stands or goes, -1 at its starting place; ``acting``: None while free or waiting.

    ``found`` and ``missed`` are the pairs (container, object) known to be there, and not to be there.
    """

    z: int
    found: frozenset
    missed: frozenset
    searched: frozenset
    places: tuple
    acting: tuple
    undecided: tuple


class ExactPaperSolver:
    """``value(joint)`` gives the expected makespan of a first joint action, ``optimum()`` the least.

    ``penalty_s`` is what a team pays on top that cannot finish. With ``exists`` likelihoods are conditioned on every
    object being somewhere.
    """

    def __init__(self, problem, penalty_s, exists=False):
        self.exists = exists
        automaton = problem.automaton
        self.delta = automaton.transitions.tolist()
        self.accepting = automaton.accepting.tolist()
        self.containers, self.objects = map(range, problem.presence_prob.shape)
        self.advancing = [{o for o in self.objects if automaton.advancing[z, o]} for z in range(len(self.delta))]
        self.needed = [self._needed(z, {z}) for z in range(len(self.delta))]
        self.travel_s = problem.kinds[0].travel_s.tolist()
        self.away_s = [robot.travel_s.tolist() for robot in problem.robots]
        self.prob = problem.presence_prob.tolist()
        self.search_s, self.interact_s, self.penalty_s = (
            problem.kinds[0].search_time_s,
            problem.kinds[0].interact_time_s,
            penalty_s,
        )
        pairs = [(c, o) for c in self.containers for o in self.objects if problem.searched[c]]
        found = frozenset(pair for pair in pairs if problem.presence_prob[pair] > 0)
        self.root = Team(
            problem.state,
            found,
            frozenset(pairs) - found,
            frozenset(c for c in self.containers if problem.searched[c]),
            tuple(robot.target if robot.target >= 0 else robot.place for robot in problem.robots),
            tuple(self._under_way(problem, robot) for robot in problem.robots),
            tuple(r for r, robot in enumerate(problem.robots) if robot.free),
        )
        self.solved = {}
        self.at_least = {}

    def optimum(self):
        return self._decide(self.root, inf)

    def value(self, joint):
        """Expected makespan when the first decision is ``joint`` (robot -> WAIT or (container, object))."""
        team = self.root
        for robot, action in sorted(joint.items()):
            team = self._begin(team, robot, action)
        return self._decide(team, inf)

    def _under_way(self, problem, robot):
        """A robot that looks for nothing in particular is taken to look for the first object needed."""
        if robot.free:
            return None
        assert robot.target >= 0, "robots that search or interact at the start are not modelled"
        obj = robot.interaction if robot.interaction >= 0 else min(self.needed[problem.state])
        arrives_s = robot.remaining_s + (0.0 if problem.searched[robot.target] else self.search_s)
        return Acting(robot.target, obj, round(arrives_s, DIGITS), round(arrives_s + self.interact_s, DIGITS))

    def _needed(self, z, seen):
        result = set(self.advancing[z])
        for o in self.advancing[z]:
            after = self.delta[z][o]
            if after not in seen:
                result |= self._needed(after, seen | {after})
        return result

    def actions(self, team, robot):
        """The robot's actions, those first that must come to an end."""
        here = team.places[robot]
        located = {o for _, o in team.found}
        now = self.advancing[team.z]
        taken = {(other.container, other.obj) for other in team.acting if other}
        ready = any((here, o) in team.found for o in self.needed[team.z] - now)
        progress, early = [], []
        for c, o in product(self.containers, self.objects):
            there = (c, o) in team.found
            useful = o in self.needed[team.z] and (c, o) not in team.missed | taken
            possible = there or (o not in located and self.prob[c][o] > 0)
            in_turn = o in now or now <= located
            merely_waits = there and o not in now and ready
            if useful and possible and in_turn and not merely_waits and self._distance_s(team, robot, c) < inf:
                (early if there and o not in now else progress).append((c, o))
        others = [r for r in range(len(team.acting)) if r != robot]
        if any(r in team.undecided or team.acting[r] for r in others) or not progress + early:
            progress.append(WAIT)
        return progress + early

    def _distance_s(self, team, robot, c):
        here = team.places[robot]
        return self.travel_s[here][c] if here >= 0 else self.away_s[robot][c]

    def _begin(self, team, robot, action):
        undecided = tuple(r for r in team.undecided if r != robot)
        if action == WAIT:
            return team._replace(undecided=undecided)
        c, o = action
        arrives_s = self._distance_s(team, robot, c) + (0.0 if c in team.searched else self.search_s)
        acting = Acting(c, o, round(arrives_s, DIGITS), round(arrives_s + self.interact_s, DIGITS))
        return team._replace(
            places=_with(team.places, robot, c),
            acting=_with(team.acting, robot, acting),
            undecided=undecided,
        )

    def _decide(self, team, bound):
        """The team's least expected time to the end, or something >= bound if that is >= bound."""
        if team in self.solved:
            return self.solved[team]
        if bound <= self.at_least.get(team, 0.0):
            return bound
        if team.undecided:
            robot, best = team.undecided[0], bound
            for action in self.actions(team, robot):
                best = min(best, self._decide(self._begin(team, robot, action), best))
        else:
            best = self._expected(team, bound)
        if best < bound:
            self.solved[team] = best
        else:
            self.at_least[team] = max(bound, self.at_least.get(team, 0.0))
        return best

    def _expected(self, team, bound):
        outcomes = self.outcomes(team)
        if not outcomes:
            return self.penalty_s
        total = sum(prob * passed_s for prob, passed_s, _ in outcomes)
        for prob, _, after in outcomes:
            if not self.accepting[after.z]:
                bound_after = (bound - total) / prob
                rest_s = self._decide(after, bound_after)
                if rest_s >= bound_after:
                    return bound
                total += prob * rest_s
        return total

    def outcomes(self, team):
        """(probability, seconds passed, team) when the first robot is free, by every content of the pairs acted on."""
        robots = [r for r, acting in enumerate(team.acting) if acting]
        if not robots:
            return []
        pairs = {(team.acting[r].container, team.acting[r].obj) for r in robots}
        open_pairs = sorted(pairs - team.found - team.missed)
        ends = {}
        for there in product((True, False), repeat=len(open_pairs)):
            weight = self._weight(team, open_pairs, there)
            present = team.found | {pair for pair, here in zip(open_pairs, there, strict=True) if here}
            if weight > 1e-12:
                passed_s, after = self._play(team, robots, present)
                before, _ = ends.get(after, (0.0, None))
                ends[after] = before + weight, passed_s
        return [(weight, passed_s, after) for after, (weight, passed_s) in ends.items()]

    def _weight(self, team, pairs, there):
        """The probability that the pairs are there or not."""
        weight = 1.0
        for o in {o for _, o in pairs}:
            holds = {c: here for (c, other), here in zip(pairs, there, strict=True) if other == o}
            here_prob = prod(self.prob[c][o] if here else 1 - self.prob[c][o] for c, here in holds.items())
            if self.exists and o not in {found for _, found in team.found}:
                unknown = [self.prob[c][o] for c in self.containers if (c, o) not in team.missed]
                nowhere = prod(1 - p for p in unknown)
                if not any(holds.values()):
                    here_prob -= nowhere
                here_prob /= 1 - nowhere
            weight *= here_prob
        return weight

    def _play(self, team, robots, present):
        """Where it ends if ``present`` are the pairs that hold."""

        def end(r):
            acting = team.acting[r]
            interacts = (acting.container, acting.obj) in present and acting.obj in self.advancing[team.z]
            return (acting.done_s if interacts else acting.arrives_s, r)

        at_s, freed = min(map(end, robots))
        acting = team.acting[freed]
        looked = {
            (team.acting[r].container, team.acting[r].obj)
            for r in robots
            if (team.acting[r].arrives_s, r) <= (at_s, freed)
        }
        advances = (acting.container, acting.obj) in present and acting.obj in self.advancing[team.z]
        passed_s = max(at_s, 0.0)
        still = tuple(
            None
            if other is None or r == freed
            else other._replace(
                arrives_s=round(other.arrives_s - passed_s, DIGITS),
                done_s=round(other.done_s - passed_s, DIGITS),
            )
            for r, other in enumerate(team.acting)
        )
        return passed_s, Team(
            self.delta[team.z][acting.obj] if advances else team.z,
            team.found | (looked & present),
            team.missed | (looked - present),
            team.searched | {c for c, _ in looked},
            team.places,
            still,
            tuple(r for r, other in enumerate(still) if other is None),
        )


def _with(items, index, item):
    return (*items[:index], item, *items[index + 1 :])
