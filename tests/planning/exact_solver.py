"""The optimum of the decision problem that `pouct` samples, by expectimax over beliefs in plain Python.

It shares no code with the kernel. Every joint action is tried; at each search the outcomes are enumerated with their
probabilities, given all that was seen and that every object still needed exists somewhere.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import inf, prod

SAME_INSTANT_S = 1e-9
WAIT = -1


@dataclass(frozen=True)
class Robot:
    """``action``: None while free, else (container, named object or None); ``busy``: None, "search" or an object."""

    reach: tuple[float, ...]  # from where it stands or departed
    place: int | None = None
    action: tuple[int, int | None] | None = None
    busy: object = None
    departed: float = 0.0
    until: float = inf

    @property
    def moving(self):
        return self.action is not None and self.busy is None


@dataclass(frozen=True)
class State:
    clock: float
    z: int
    held: tuple[frozenset | None, ...]  # None: not searched
    robots: tuple[Robot, ...]
    undecided: frozenset

    @cached_property
    def found(self):
        return frozenset().union(*(objects for objects in self.held if objects))


class ExactSolver:
    """``value(joint)`` gives the expected makespan of a first joint action, ``optimum()`` the least."""

    def __init__(self, problem, prob, reassign_all=True, decide_all=None):
        self.problem, self.prob = problem, prob
        automaton = problem.automaton
        states, objects = automaton.transitions.shape
        self.delta = automaton.transitions
        self.accepting = automaton.accepting
        self.advancing = [frozenset(o for o in range(objects) if automaton.advancing[z, o]) for z in range(states)]
        self.harmless = [
            frozenset(o for o in self.advancing[z] if automaton.includes[self.delta[z, o], z]) for z in range(states)
        ]
        if decide_all is None:
            decide_all = problem.interact_time_s > 0
        self.safe = [frozenset()] * states if decide_all else self.harmless  # the automatic interactions
        self.steps = automaton.steps_to_accept
        self.needed = [self._needed(z, set()) for z in range(states)]
        self.travel = problem.travel_s
        robots, undecided = [], set()
        for index, status in enumerate(problem.robots):
            robot = Robot(tuple(status.travel_s), status.place if status.place >= 0 else None)
            if status.free:
                undecided.add(index)
            else:
                robot = replace(robot, action=(status.target, None), until=status.remaining_s, place=None)
                if reassign_all:
                    undecided.add(index)
            robots.append(robot)
        held = tuple(
            frozenset(o for o in range(objects) if problem.holds(c, o)) if problem.searched[c] else None
            for c in range(len(problem.searched))
        )
        self.root = State(0.0, problem.state, held, tuple(robots), frozenset(undecided))

    def optimum(self):
        return self._decide(self.root)

    def value(self, joint):
        """Expected makespan when the first decision is ``joint`` (robot -> container, WAIT or (container, object))."""
        state = self.root
        for robot, action in joint.items():
            state = self._act(state, robot, action)
        return self._expected(state)

    def _needed(self, z, seen):
        result = set(self.advancing[z])
        for o in self.advancing[z]:
            after = int(self.delta[z, o])
            if after not in seen:
                result |= self._needed(after, seen | {z})
        return frozenset(result)

    def _distance(self, state, r, c):
        robot = state.robots[r]
        if not robot.moving:
            return robot.reach[c]
        return min(
            robot.until - state.clock + self.travel[robot.action[0], c], state.clock - robot.departed + robot.reach[c]
        )

    def _actions(self, state, r):
        taken = {
            robot.action[0]
            for index, robot in enumerate(state.robots)
            if robot.action is not None and index not in state.undecided
        }
        robot, needed = state.robots[r], self.needed[state.z]
        ready = (
            not robot.moving
            and robot.place is not None
            and state.held[robot.place] is not None
            and state.held[robot.place] & needed - self.advancing[state.z]
        )
        for c, held in enumerate(state.held):
            if c in taken or self._distance(state, r, c) == inf:
                continue
            if held is None:
                if any(self.prob[c][o] > 0 for o in needed - state.found):
                    yield c
            elif held & needed & self.safe[state.z] or (held & needed - self.advancing[state.z] and not ready):
                yield c
        for o in self.advancing[state.z] - self.safe[state.z]:
            places = [c for c, held in enumerate(state.held) if held and o in held]
            if places:
                yield (min(places, key=lambda c: self._distance(state, r, c)), o)
        others = [index for index in range(len(state.robots)) if index != r]
        if any(index in state.undecided or state.robots[index].action is not None for index in others):
            yield WAIT

    def _act(self, state, r, action):
        robot = state.robots[r]
        undecided = state.undecided - {r}
        if action == WAIT:
            if robot.moving:
                reach = tuple(self._distance(state, r, c) for c in range(len(state.held)))
                robot = replace(robot, reach=reach, place=None)
            robot = replace(robot, action=None, busy=None, until=inf)
        else:
            target, named = action if isinstance(action, tuple) else (action, None)
            if robot.moving and robot.action[0] == target:
                robot = replace(robot, action=(target, named))
            else:
                reach = tuple(self._distance(state, r, c) for c in range(len(state.held)))
                robot = Robot(
                    reach,
                    robot.place,
                    (target, named),
                    None,
                    state.clock,
                    state.clock + reach[target],
                )
        robots = tuple(robot if index == r else other for index, other in enumerate(state.robots))
        return replace(state, robots=robots, undecided=undecided)

    def _decide(self, state):
        if not state.undecided:
            return self._expected(state)
        r = min(state.undecided)
        options = [self._act(state, r, action) for action in self._actions(state, r)]
        if not options:
            options = [self._act(state, r, WAIT)]
        return min(self._decide(option) for option in options)

    def _expected(self, state):
        total = 0.0
        for prob, after, done in self._advance(state, freed=False, news=False):
            total += prob * (after.clock if done else self._decide(after))
        return total

    def _advance(self, state, freed, news):
        """(probability, state, done) at the next decision instant."""
        due = min(range(len(state.robots)), key=lambda r: state.robots[r].until)
        until = state.robots[due].until
        if until == inf and not freed:
            yield 1.0, replace(state, clock=inf), True
            return
        if freed and until > state.clock + SAME_INSTANT_S:
            undecided = {r for r, robot in enumerate(state.robots) if robot.action is None or (news and robot.moving)}
            yield 1.0, replace(state, undecided=frozenset(undecided)), False
            return
        state = replace(state, clock=max(state.clock, until))
        for prob, after, freed_now, news_now in self._event(state, due):
            if self.accepting[after.z]:
                yield prob, after, True
                continue
            for more, final, done in self._advance(after, freed or freed_now, news or news_now):
                yield prob * more, final, done

    def _event(self, state, r):
        robot = state.robots[r]
        container = robot.action[0]
        if robot.moving:
            robot = replace(robot, reach=tuple(self.travel[container]), place=container)
            if state.held[container] is None:
                if self.problem.search_time_s > 0:
                    busy = replace(robot, busy="search", until=robot.until + self.problem.search_time_s)
                    yield 1.0, self._with(state, r, busy), False, False
                    return
                robot = replace(robot, busy="search")
            state = self._with(state, r, robot)
        if robot.busy == "search" and state.held[container] is None:
            for prob, objects in self._contents(state, container):
                held = tuple(objects if c == container else other for c, other in enumerate(state.held))
                news = bool(objects - state.found)
                yield prob, *self._interact(State(state.clock, state.z, held, state.robots, state.undecided), r, news)
            return
        if robot.busy not in (None, "search"):
            obj, z = robot.busy, state.z
            news = obj in self.advancing[z]
            if news:
                state = replace(state, z=int(self.delta[z, obj]))
            named = robot.action[1] is not None
            state = self._with(state, r, self._freed(robot) if named else replace(robot, busy="search"))
            if news:
                state = self._wake(state)
            yield 1.0, *((state, True, news) if named else self._interact(state, r, news))
            return
        yield 1.0, *self._interact(state, r, news=False)

    def _wake(self, state):
        """Robots that stand at an object whose time has come begin with it."""
        for index, robot in enumerate(state.robots):
            if robot.action is None and robot.place is not None and state.held[robot.place] is not None:
                waiting = self._with(state, index, replace(robot, action=(robot.place, None), busy="search"))
                begun, freed, _ = self._interact(waiting, index, news=False)
                state = state if freed else begun
        return state

    def _interact(self, state, r, news):
        """(state, freed, news) after the robot begins the interaction its action allows, or is free."""
        robot = state.robots[r]
        container, named = robot.action
        allowed = self.safe[state.z] if named is None else self.advancing[state.z] & {named}
        options = sorted(state.held[container] & allowed, key=lambda o: (self.steps[self.delta[state.z, o]], o))
        if not options:
            return self._with(state, r, self._freed(robot)), True, news
        until = state.clock + self.problem.interact_time_s
        return self._with(state, r, replace(robot, busy=options[0], until=until)), False, news

    def _contents(self, state, container):
        """(probability, objects) of a container about to be searched."""
        relevant = sorted(self.needed[state.z])
        probs = []
        for o in relevant:
            here = self.prob[container][o]
            if o not in state.found:
                nowhere = prod(1 - self.prob[c][o] for c, held in enumerate(state.held) if held is None)
                here /= 1 - nowhere
            probs.append(min(here, 1.0))
        for bits in product((False, True), repeat=len(relevant)):
            weight = prod(p if bit else 1 - p for bit, p in zip(bits, probs, strict=True))
            if weight > 1e-12:
                yield weight, frozenset(o for bit, o in zip(bits, relevant, strict=True) if bit)

    @staticmethod
    def _freed(robot):
        return replace(robot, action=None, busy=None, until=inf)

    @staticmethod
    def _with(state, r, robot):
        return replace(state, robots=tuple(robot if i == r else other for i, other in enumerate(state.robots)))
