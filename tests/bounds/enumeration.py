"""All worlds of a small belief with their probabilities, and the bounds as exact means over them."""

from itertools import product

import numpy as np

from mrtask.bounds.one_robot import one_robot_bound
from mrtask.bounds.team_bound import best_curves, integrate, team_curves
from mrtask.planning.clairvoyant import clairvoyant_s
from mrtask.planning.solver_belief import belief_of


def all_worlds(belief):
    """(worlds [K, C, O], probabilities [K]): every placing of the objects still needed in which each is somewhere."""
    relevant = np.flatnonzero(belief.needed[belief.state])
    cells = [(c, o) for c in np.flatnonzero(belief.unsearched) for o in relevant]
    worlds, weights = [], []
    for bits in product((False, True), repeat=len(cells)):
        world, weight = belief.known.copy(), 1.0
        for (c, o), bit in zip(cells, bits, strict=True):
            world[c, o] = bit
            weight *= belief.prob[c, o] if bit else 1 - belief.prob[c, o]
        if world[:, relevant].any(axis=0).all():
            worlds.append(world)
            weights.append(weight)
    return np.array(worlds), np.array(weights) / sum(weights)


def mean_bounds(problem):
    """(bound, clairvoyant bound, whether the former should be the optimum) in expectation over all worlds."""
    belief = belief_of(problem)
    worlds, weights = all_worlds(belief)
    clairvoyant = weights @ [clairvoyant_s(belief, world) for world in worlds]
    if belief.robots == 1:
        bound = one_robot_bound(belief, worlds)
        return weights @ bound.values_s, clairvoyant, bound.exact
    grid_s, curves = team_curves(belief, worlds)
    return weights @ integrate(grid_s, curves, best_curves(curves, weights)), clairvoyant, False
