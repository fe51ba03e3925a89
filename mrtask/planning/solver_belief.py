"""The input of the bounds: a decision problem with its belief, and hidden worlds drawn from it.

A world says which unsearched container holds which task object. Containers and objects are independent, with one
exception: every object that no searched container holds is in some container. `pouct` samples this same distribution
(`mrtask.planning.team_kernel`), so a bound on the expected makespan over these worlds bounds every planner's.

Legend for array shapes: R robots, C containers, O task objects, Z automaton states, K worlds.
"""

from dataclasses import dataclass

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.planning.problem import PlanningProblem, needed, safe
from mrtask.planning.team_model import team_model
from mrtask.tasks.automaton import Automaton


@dataclass(frozen=True, eq=False)
class Belief:
    """A decision problem as the bounds see it. Containers out of reach hold nothing and are never visited.

    If robots differ, each counts as if it had the fastest ways and the least times of all, and could touch everything.
    """

    automaton: Automaton
    state: int
    travel_s: Floats
    """[C, C] shortest times, by way of other containers where that is shorter, so that the triangle inequality
    holds."""
    start_s: Floats
    """[R, C] the same from each robot's position."""
    unsearched: Bools
    """[C] containers within reach that no robot has searched."""
    known: Bools
    """[C, O] contents of the searched containers."""
    prob: Floats
    """[C, O] likelihoods in unsearched containers, 0 in all others."""
    needed: Bools
    """[Z, O]"""
    safe: Bools
    """[Z, O]"""
    search_time_s: float
    interact_time_s: float

    @property
    def robots(self) -> int:
        """Return the team's size."""
        return len(self.start_s)

    @property
    def found(self) -> Bools:
        """Return, for each object [O], whether a searched container holds it."""
        return np.asarray(self.known.any(axis=0))

    @property
    def nowhere_prob(self) -> Floats:
        """Return the probability [O] that no unsearched container holds an object, as if it were not known to exist."""
        return np.asarray(np.prod(1.0 - self.prob, axis=0))


def belief_of(problem: PlanningProblem) -> Belief:
    """Return the belief of a problem, with the likelihoods that the search planners use.

    Raises:
        ValueError: a robot is searching or interacting; bounds need a team whose robots can go anywhere at once.
    """
    if any(not robot.free and robot.target < 0 for robot in problem.robots):
        raise ValueError("a robot is busy; bounds are for instants at which every robot is free or under way")
    kinds = [problem.kinds[robot.kind] for robot in problem.robots]
    travel_s = np.min([kind.travel_s for kind in kinds], axis=0)
    for via in range(len(travel_s)):
        np.minimum(travel_s, travel_s[:, [via]] + travel_s[[via]], out=travel_s)
    start_s = np.array([robot.travel_s for robot in problem.robots])
    start_s = np.minimum(start_s, (start_s[:, :, None] + travel_s).min(axis=1))
    reachable = np.isfinite(start_s).any(axis=0)
    unsearched = reachable & ~problem.searched
    return Belief(
        automaton=problem.automaton,
        state=problem.state,
        travel_s=travel_s,
        start_s=start_s,
        unsearched=unsearched,
        known=(problem.presence_prob > 0) & (problem.searched & reachable)[:, None],
        prob=np.where(unsearched[:, None], team_model(problem).prob, 0.0),
        needed=needed(problem.automaton),
        safe=safe(problem.automaton),
        search_time_s=min(kind.search_time_s for kind in kinds),
        interact_time_s=min(kind.interact_time_s for kind in kinds),
    )


def draw_worlds(belief: Belief, count: int, rng: np.random.Generator) -> Bools:
    """Draw the contents of all containers in ``count`` worlds, [K, C, O]. Searched ones stay as they were found.

    Raises:
        ValueError: an object is not found and no container can hold it.
    """
    nowhere = belief.nowhere_prob
    lost = ~belief.found & (nowhere >= 1.0)
    if lost.any():
        names = ", ".join(np.array(belief.automaton.propositions)[lost])
        raise ValueError(f"no unsearched container can hold {names}: no world is possible under the belief")
    worlds = np.repeat(belief.known[None], count, axis=0)
    exists = np.repeat(belief.found[None], count, axis=0)
    for container in np.flatnonzero(belief.unsearched):
        prob = belief.prob[container]
        here = rng.random(exists.shape) * np.where(exists, 1.0, 1.0 - nowhere) < prob
        worlds[:, container] = here
        exists |= here
        nowhere = np.minimum(nowhere / (1.0 - prob), 1.0)
    return worlds
