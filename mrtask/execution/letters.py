"""The letters that the interactions of one instant spell."""

from functools import cache

from mrtask.tasks.automaton import Automaton


def serving_order(automaton: Automaton, state: int, objects: frozenset[int]) -> list[int]:
    """Return the order of one instant's interactions that leaves the task nearest to done.

    An interaction is dropped only if it does not advance the task when its turn comes. Of the orders that end equally
    near, the one that drops fewest interactions wins, and then the one with the lower object index first.
    """

    @cache
    def best(state: int, rest: frozenset[int]) -> tuple[int, tuple[int, ...]]:
        orders = []
        for obj in sorted(rest):
            if automaton.advancing[state, obj]:
                steps, order = best(int(automaton.transitions[state, obj]), rest - {obj})
                orders.append((steps, (obj, *order)))
        idle = (int(automaton.steps_to_accept[state]), ())
        return min(orders, key=lambda option: (option[0], -len(option[1])), default=idle)

    return list(best(state, objects)[1])
