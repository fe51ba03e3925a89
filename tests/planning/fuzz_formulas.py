"""Random tasks with X and U, nested, for all planners: every episode must end.

By hand: ``python -m tests.planning.fuzz_formulas 10000``. A planner that hangs in compiled code cannot be interrupted,
so a watchdog ends the process and shows where it was.
"""

import faulthandler
import random
import sys
from collections import Counter

import networkx as nx
import numpy as np

from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.progression import FormulaTooLargeError
from tests.planning.play import Play
from tests.planning.problems import make_problem

ATOMS = tuple("abcdefgh")
MAX_STATES = 60
MAX_DECISIONS = 200
WATCHDOG_S = 120
OPTIONS = {"pouct": {"samples": 60}, "known": {"samples": 60}, "pouct_paper": {"samples": 60}}


def random_formula(rng, atoms, depth):
    """A co-safe formula: negation at atoms alone."""
    if depth == 0:
        atom = rng.choice(atoms)
        return atom if rng.random() < 0.8 else f"!{atom}"

    def inner():
        return random_formula(rng, atoms, rng.randrange(depth))

    kind = rng.choice("FFXXU&&|")
    return f"{kind} ({inner()})" if kind in "FX" else f"(({inner()}) {kind} ({inner()}))"


def random_task(number):
    """The ``number``-th task: its automaton, which can be accepted and is not at the start."""
    rng = random.Random(number)
    while True:
        atoms = ATOMS[: rng.randint(2, len(ATOMS))]
        formula = random_formula(rng, atoms, rng.randint(2, 5))
        try:
            automaton = build_automaton(formula, max_states=MAX_STATES)
        except FormulaTooLargeError:
            continue
        open_at_start = automaton.initial != automaton.sink and not automaton.accepting[automaton.initial]
        if open_at_start and (number % 2 or has_cycle(automaton)):
            return automaton


def has_cycle(automaton):
    """Whether interactions can lead through two states or more and back."""
    edges = {(z, int(to)) for z, row in enumerate(automaton.transitions) for to in row}
    ways = nx.DiGraph(edges)
    return any(len(part) > 1 for part in nx.strongly_connected_components(ways))


def problem_of(number, automaton):
    """A problem with that task, half of its containers known from the start and places shared; and what is where."""
    rng = np.random.default_rng(number)
    containers, robots = int(rng.integers(2, 7)), int(rng.integers(1, 4))
    names = automaton.propositions
    truth = rng.random((containers, len(names))) < 0.4
    truth[rng.integers(containers, size=len(names)), np.arange(len(names))] = True
    prob = np.where(truth, 0.6, 0.2)
    searched = np.flatnonzero(rng.random(containers) < 0.5)
    prob[searched] = truth[searched]
    points = rng.integers(3, size=(containers, 2)) * 3.0
    times = {"interact_time_s": float(rng.choice([0.0, 0.0, 1.0])), "search_time_s": float(rng.choice([0.0, 0.0, 1.0]))}
    starts = points[rng.integers(containers, size=robots)]
    return make_problem(automaton.formula, names, points, starts, prob, searched=searched, **times), truth


def play(number):
    """How each planner's episode of a task ended."""
    automaton = random_task(number)
    problem, truth = problem_of(number, automaton)
    ended = {}
    for name in PLANNERS:
        planner = make_planner(name, OPTIONS.get(name))
        faulthandler.dump_traceback_later(WATCHDOG_S, exit=True)
        try:
            ended[name] = Play(problem, truth).run(planner, limit=MAX_DECISIONS)
        finally:
            faulthandler.cancel_dump_traceback_later()
    return automaton, ended


def main(first, count):
    outcomes, longest = Counter(), 0
    for number in range(first, first + count):
        automaton, ended = play(number)
        for name, played in ended.items():
            outcomes[name, played.accepted] += 1
            longest = max(longest, played.decisions)
            if played.decisions == MAX_DECISIONS:
                print(number, name, automaton.formula, "went round in circles", flush=True)
    print(
        {f"{name} {'accepted' if good else 'not'}": n for (name, good), n in sorted(outcomes.items())},
        "longest",
        longest,
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3])) if len(sys.argv) > 2 else main(0, int(sys.argv[1]))
