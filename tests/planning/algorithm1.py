"""The paper's belief-state abstraction: concurrent actions <container, object> and their outcomes (Algorithm 1).

A team belief is advanced until the first robot is free again: it did not find its object, or it found it and finished
interacting. This is the readable form; `mrtask.planning.paper.search_kernel` draws one outcome of the same
distribution.
"""

from dataclasses import dataclass, replace
from math import prod

from mrtask.tasks.automaton import Automaton

Pair = tuple[int, int]
"""A container and an object."""


@dataclass(frozen=True)
class RobotAction:
    """A robot's <container, object>: at ``arrive_s`` it has searched, at ``done_s`` interacted if it found it."""

    container: int
    obj: int
    arrive_s: float
    done_s: float

    @property
    def pair(self) -> Pair:
        """``(container, obj)``."""
        return (self.container, self.obj)


@dataclass(frozen=True)
class TeamBelief:
    """What the team knows and does at ``time_s``; a robot without action is free or waits."""

    time_s: float
    state: int
    present: frozenset[Pair]
    absent: frozenset[Pair]
    actions: tuple[RobotAction | None, ...]


@dataclass(frozen=True)
class Outcome:
    """One way the team's actions can go until the first robot is free."""

    prob: float
    belief: TeamBelief
    robot: int
    found: bool


def advance_belief_until_robot_free(
    belief: TeamBelief, automaton: Automaton, likelihood: dict[Pair, float], *, exists: bool = False
) -> list[Outcome]:
    """The paper's Algorithm 1: the distribution over team beliefs when the first robot becomes free.

    Events are walked in time order, the lower robot index first at equal times, failure before success for one action.
    At a failure event the branch "this one not found, every earlier one found" ends; the walk goes on as if it was
    found. The first success event ends the walk. (The listing forgets the earlier finds at each step, the text and its
    product formula keep them; so do we.) An object whose turn in the task has not come is found without an interaction.

    Args:
        likelihood: probability that the object is in the container, for pairs neither known present nor absent.
        exists: condition it on the object being in some container.

    Returns:
        The outcomes of positive probability, which sum to 1.

    Raises:
        ValueError: no robot acts, so nothing will happen.
    """
    events = []
    for robot, action in enumerate(belief.actions):
        if action is not None:
            advances = bool(automaton.advancing[belief.state, action.obj])
            events.append((action.arrive_s, robot, 0, action))
            events.append((action.done_s if advances else action.arrive_s, robot, 1, action))
    if not events:
        raise ValueError("every robot waits: at least one must act for a robot to become free")
    outcomes: list[Outcome] = []
    weight, present = 1.0, belief.present
    for event_s, robot, success, action in sorted(events, key=lambda event: event[:3]):
        time_s = max(event_s, belief.time_s)  # what a robot found earlier, it may learn to be of no use only now
        if success:
            advances = bool(automaton.advancing[belief.state, action.obj])
            state = int(automaton.transitions[belief.state, action.obj]) if advances else belief.state
            after = replace(belief, time_s=time_s, state=state, present=present, actions=_freed(belief, robot))
            outcomes.append(Outcome(weight, after, robot, found=True))
            break
        there = 1.0 if action.pair in present else 0.0 if action.pair in belief.absent else likelihood[action.pair]
        if exists and action.pair not in present and action.obj not in {obj for _, obj in present}:
            open_pairs = [pair for pair in likelihood if pair[1] == action.obj and pair not in belief.absent]
            there /= 1.0 - prod(1.0 - likelihood[pair] for pair in open_pairs)
        if there < 1.0:
            absent = belief.absent | {action.pair}
            after = replace(belief, time_s=time_s, present=present, absent=absent, actions=_freed(belief, robot))
            outcomes.append(Outcome(weight * (1.0 - there), after, robot, found=False))
        weight *= there
        if weight == 0.0:
            break
        present |= {action.pair}
    return outcomes


def _freed(belief: TeamBelief, robot: int) -> tuple[RobotAction | None, ...]:
    return tuple(None if index == robot else action for index, action in enumerate(belief.actions))
