import pickle
import warnings
from itertools import combinations, product

import networkx as nx
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from mrtask.tasks.automaton import NEVER_ACCEPTS, build_automaton, check_task
from mrtask.tasks.formula import FormulaError, parse, push_negations
from mrtask.tasks.progression import MAX_ATOMS, TRUE, Progression
from mrtask.tasks.templates import TEMPLATES, make_formula
from tests.tasks.naive_ltl import good_words, text_of, words

with warnings.catch_warnings():
    # Its SWIG types warn during the import, and under "warnings are errors" that crashes the interpreter.
    warnings.simplefilter("ignore")
    import spot

LETTERS = ("a", "b", "c")
RANDOM = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


def random_formulas(depth, negated=False):
    """Formulas that are co-safe (or whose negation is, where ``negated``)."""
    literals = st.sampled_from([*LETTERS, *(("!", letter) for letter in LETTERS)])
    if depth == 0:
        return literals
    same = random_formulas(depth - 1, negated)
    opposite = random_formulas(depth - 1, not negated)
    pairs = st.lists(same, min_size=2, max_size=3)
    options = [
        st.builds(lambda parts: ("&", *parts), pairs),
        st.builds(lambda parts: ("|", *parts), pairs),
        st.tuples(st.just("X"), same),
        st.tuples(st.just("!"), opposite),
        st.tuples(st.just("->"), opposite, same),
    ]
    if not negated:
        options += [st.tuples(st.just("F"), same), st.tuples(st.just("U"), same, same)] * 2
    if depth == 1:
        options += [literals, st.booleans()]
    return st.one_of(options)


def random_tasks(depth):
    """Mostly conjunctions of ``F`` and ``U`` formulas, as tasks are; the others are often true or false."""
    inner = st.one_of(*(random_formulas(less) for less in range(depth)))
    temporal = st.one_of(st.tuples(st.just("F"), inner), st.tuples(st.just("U"), inner, inner))
    conjunctions = st.lists(temporal, min_size=2, max_size=4, unique=True).map(lambda parts: ("&", *parts))
    return st.one_of(conjunctions, conjunctions, random_formulas(depth))


def accepted_words(automaton, longest, start=None):
    return {
        word for word in words(automaton.propositions, longest) if automaton.accepting[automaton.run(word, start=start)]
    }


@settings(RANDOM, max_examples=100)
@given(formula=random_tasks(3), all_brackets=st.booleans())
@example(formula=("F", ("&", "a", ("X", ("F", ("&", "b", ("X", ("F", "c"))))))), all_brackets=False)
@example(formula=("&", ("F", ("&", "a", ("X", "a"))), ("U", ("!", "b"), "c")), all_brackets=False)
@example(formula=("|", ("U", ("|", "a", "b"), ("X", "c")), ("X", ("X", ("U", ("!", "c"), "b")))), all_brackets=False)
def test_accepts_the_good_prefixes_of_the_definition(formula, all_brackets):
    automaton = build_automaton(text_of(formula, all_brackets), LETTERS)
    assert accepted_words(automaton, 5) == good_words(formula, LETTERS, 5)


def spot_automaton(formula):
    """Spot's automaton over letters with at most one proposition: successors by letter and the universal states."""
    two_at_once = " | ".join(f"({one} & {other})" for one, other in combinations(LETTERS, 2))
    automaton = spot.translate(
        f"({text_of(formula, all_brackets=True)}) | F ({two_at_once})", "Buchi", "deterministic", "complete", "sbacc"
    )
    assert automaton.is_deterministic()
    graph = nx.DiGraph((edge.src, edge.dst) for edge in automaton.edges())
    rejecting = set()
    for component in nx.strongly_connected_components(graph):
        if graph.subgraph(component).number_of_edges():
            kinds = {automaton.state_is_accepting(state) for state in component}
            assert len(kinds) == 1, "a weak automaton has no mixed components"
            rejecting |= component if kinds == {False} else set()
    doomed = rejecting.union(*(nx.ancestors(graph, state) for state in rejecting))
    bdds = automaton.get_dict()
    successors = {}
    for letter in LETTERS:
        alone = spot.formula(" & ".join(name if name == letter else f"!{name}" for name in LETTERS))
        valuation = spot.formula_to_bdd(alone, bdds, automaton)
        for edge in automaton.edges():
            if not spot.bdd_to_formula(edge.cond & valuation, bdds).is_ff():
                successors[edge.src, letter] = edge.dst
    return automaton.get_init_state_number(), successors, set(graph) - doomed


@settings(RANDOM, max_examples=300)
@given(formula=random_tasks(4))
def test_agrees_with_spot(formula):
    automaton = build_automaton(text_of(formula), LETTERS)
    initial, successors, universal = spot_automaton(formula)
    pairs = {(automaton.initial, initial)}
    pending = list(pairs)
    while pending:
        ours, theirs = pending.pop()
        assert automaton.accepting[ours] == (theirs in universal)
        for letter in LETTERS:
            pair = (automaton.run([letter], start=ours), successors[theirs, letter])
            if pair not in pairs:
                pairs.add(pair)
                pending.append(pair)
    assert {ours for ours, _ in pairs} == set(range(len(automaton.transitions)))


@settings(RANDOM, max_examples=60)
@given(formula=random_tasks(4))
def test_is_minimal_with_one_accepting_state_and_one_sink_at_most(formula):
    automaton = build_automaton(text_of(formula), LETTERS)
    states = range(len(automaton.transitions))
    # The table-filling algorithm: pairs told apart by a word.
    apart = {(x, y) for x, y in product(states, repeat=2) if automaton.accepting[x] != automaton.accepting[y]}
    grown = True
    while grown:
        more = {
            (x, y)
            for x, y in product(states, repeat=2)
            if any(pair in apart for pair in zip(automaton.transitions[x], automaton.transitions[y], strict=True))
        }
        grown = not more <= apart
        apart |= more
    assert len(apart) == len(states) * (len(states) - 1)

    graph = nx.DiGraph((x, int(y)) for x in states for y in automaton.transitions[x])
    assert set(nx.descendants(graph, automaton.initial)) | {automaton.initial} == set(states)
    accepting = [state for state in states if automaton.accepting[state]]
    assert len(accepting) <= 1
    assert all((automaton.transitions[state] == state).all() for state in accepting)
    distance = nx.single_target_shortest_path_length(graph, accepting[0]) if accepting else {}
    distance = dict(distance)
    assert [distance.get(state, NEVER_ACCEPTS) for state in states] == automaton.steps_to_accept.tolist()
    assert [state for state in states if state not in distance] == [automaton.sink] * (automaton.sink >= 0)
    for state, column in product(states, range(len(LETTERS))):
        successor = int(automaton.transitions[state, column])
        assert automaton.advancing[state, column] == (successor != state and successor in distance)


@settings(RANDOM, max_examples=40)
@given(formula=random_tasks(3))
@example(formula=("X", ("X", ("!", "c"))))  # takes several rounds
@example(formula=("|", ("X", "c"), ("F", ("X", "a"))))
def test_inclusion_agrees_with_the_words_that_states_accept(formula):
    automaton = build_automaton(text_of(formula), LETTERS)
    assume(2 < len(automaton.transitions) <= 8)
    accepted = [accepted_words(automaton, 6, start=state) for state in range(len(automaton.transitions))]
    assert automaton.includes.tolist() == [[one >= other for other in accepted] for one in accepted]


@pytest.mark.parametrize(
    ("formula", "propositions", "accepts"),
    [
        ("true", [], True),
        ("X true", ["a"], True),
        ("a | !a", ["a"], True),
        ("F a | !a", ["a"], True),
        ("X (!a | !b)", ["a", "b"], True),  # no letter has both
        ("a -> X (F b | !b)", ["a", "b"], True),
        ("F a", ["a"], False),  # the team may do nothing
        ("a | b", ["a", "b"], False),
        ("F a | F b", ["a", "b"], False),
        ("!a", ["a"], False),
        ("false", ["a"], False),
    ],
)
def test_accepts_at_once_only_what_is_certain_whatever_happens(formula, propositions, accepts):
    automaton = build_automaton(formula, propositions)
    assert automaton.accepting[automaton.initial] == accepts
    assert not (accepts and automaton.advancing.any())


def test_a_formula_that_no_sequence_of_the_propositions_satisfies_starts_in_the_sink():
    automaton = build_automaton("!a & !b", ["a", "b"])
    assert (automaton.sink, automaton.initial, automaton.transitions.tolist()) == (0, 0, [[0, 0]])
    other = build_automaton("!a & !b", ["a", "b", "c"])
    assert other.accepting[other.run("c")]
    assert other.run("a") == other.sink != other.initial


def test_columns_are_the_propositions_in_their_order():
    formula = "(!b U a) & F b"
    assert build_automaton(formula).propositions == ("b", "a")
    assert build_automaton(formula, {"c", "b", "a"}).propositions == ("a", "b", "c")
    automaton = build_automaton(formula, ["c", "a", "b"])
    assert automaton.propositions == ("c", "a", "b")
    assert automaton.transitions.tolist() == [[0, 1, 2], [1, 1, 3], [2, 2, 2], [3, 3, 3]]
    assert automaton.accepting.tolist() == [False, False, False, True]
    assert automaton.sink == 2
    assert automaton.advancing.tolist() == [[False, True, False], [False, False, True], [False] * 3, [False] * 3]
    assert automaton.transitions.dtype == automaton.steps_to_accept.dtype == np.int32
    assert automaton.accepting.dtype == automaton.advancing.dtype == automaton.includes.dtype == np.bool_


def test_advancing_is_wider_than_coming_nearer():
    automaton = build_automaton("F a & (F b | (F c & F d))", list("abcd"))
    assert automaton.advancing[automaton.initial].tolist() == [True, True, True, True]
    nearer = automaton.steps_to_accept[automaton.transitions[0]] < automaton.steps_to_accept[0]
    assert nearer.tolist() == [True, True, False, False]


def test_inclusion_tells_a_harmless_interaction_from_one_that_can_hurt():
    automaton = build_automaton("(!c U a) & F b & F c", list("abc"))
    after_a, after_c = (automaton.run([letter]) for letter in "ac")
    assert automaton.includes[after_a, automaton.initial]
    assert not automaton.includes[automaton.initial, after_a]
    assert not automaton.includes[after_c, automaton.initial]
    # After c, the other way to the goal is closed.
    either = build_automaton("(!c U a) | F (c & X F b)", list("abc"))
    assert not either.includes[either.run("c"), either.initial]


def test_ten_unordered_objects_give_a_state_for_each_set_of_them():
    names = [f"Object{number}" for number in range(10)]
    automaton = build_automaton(" & ".join(f"F {name}" for name in names), names)
    assert automaton.transitions.shape == (1024, 10)
    done = {automaton.initial: frozenset()}
    for state in range(1024):  # breadth first: a state's predecessors come before it
        for column, successor in enumerate(automaton.transitions[state].tolist()):
            assert done.setdefault(successor, done[state] | {column}) == done[state] | {column}
    assert len(set(done.values())) == 1024
    assert automaton.steps_to_accept.tolist() == [10 - len(done[state]) for state in range(1024)]
    masks = np.array([sum(1 << column for column in done[state]) for state in range(1024)])
    assert (automaton.includes == ((masks[:, None] & masks[None, :]) == masks[None, :])).all()


def test_equal_functions_of_the_parts_are_one_state():
    progression = Progression()
    states = [
        progression.state(push_negations(parse(text)))
        for text in ("F a & F b", "F b & (F a | F b & false) & F b", "F a & F b & (F a | X c)", "F b & !!F a | false")
    ]
    assert len(set(states)) == 1
    assert progression.state(parse("(b & a) | a")) == progression.state(parse("a"))


def test_wide_alternations_of_and_and_or_do_not_blow_up():
    pairs = " & ".join(f"(F a{number} | F b{number})" for number in range(8))
    assert len(build_automaton(f"({pairs}) | F z").transitions) == 256
    pairs = " | ".join(f"(F a{number} & F b{number})" for number in range(6))
    assert len(build_automaton(pairs).transitions) == 3**6 + 1


def test_max_states_is_the_most_states_explored():
    formula = "F a & F b & F c"
    assert len(build_automaton(formula, max_states=8).transitions) == 8
    with pytest.raises(
        ValueError, match=r"too large: it has more than max_states=7 states .*simplify the formula or raise max_states"
    ):
        build_automaton(formula, max_states=7)
    with pytest.raises(ValueError, match="max_states must be at least 1, not 0"):
        build_automaton(formula, max_states=0)


def test_hundreds_of_different_parts_are_handled_and_too_many_refused():
    even, odd = (" | ".join(f"F o{number}" for number in range(first, MAX_ATOMS, 2)) for first in (0, 1))
    progression = Progression()
    state = progression.state(push_negations(parse(f"({even}) & ({odd})")))
    assert progression.after(state, None) == state
    assert progression.after(progression.after(state, "o7"), "o8") == TRUE
    with pytest.raises(ValueError, match="too large: it has more than 500 different parts; simplify the formula"):
        build_automaton(f"({even}) & ({odd}) & F o500")


def test_too_large_states_are_refused(monkeypatch):
    monkeypatch.setattr("mrtask.tasks.progression.MAX_NODES", 10)
    with pytest.raises(ValueError, match="too large: its states have more than 10 decision nodes; simplify"):
        build_automaton(" & ".join(f"F o{number}" for number in range(6)))


def test_bad_formulas_and_names_are_refused():
    with pytest.raises(FormulaError, match="unknown object 'b'"):
        build_automaton("F a & F b", ["a"])
    with pytest.raises(FormulaError, match="not co-safe"):
        build_automaton("F a & G b")
    with pytest.raises(ValueError, match=r"the name 'Spray.Bottle' holds"):
        build_automaton("F a", ["a", 'Spray"Bottle'])
    with pytest.raises(ValueError, match="no proposition 'd' in this task; it has: a, b"):
        build_automaton("F a & F b").run(["a", "d"])


def test_dot_shows_states_kinds_and_letters():
    automaton = build_automaton("(!Mug U Pen) &\n F Mug", ["Pen", "Mug", "Cup"])
    assert automaton.to_dot() == (
        "digraph task {\n"
        '  label="(!Mug U Pen) & F Mug"; labelloc=t; rankdir=LR;\n'
        '  start [shape=point, label=""];\n'
        "  0 [shape=circle];\n"
        "  1 [shape=circle];\n"
        "  2 [shape=circle, color=gray];\n"
        "  3 [shape=doublecircle];\n"
        "  start -> 0;\n"
        '  0 -> 1 [label="Pen"];\n'
        '  0 -> 2 [label="Mug"];\n'
        '  0 -> 0 [label="Cup"];\n'
        '  1 -> 1 [label="Pen, Cup"];\n'
        '  1 -> 3 [label="Mug"];\n'
        '  2 -> 2 [label="Pen, Mug, Cup"];\n'
        '  3 -> 3 [label="Pen, Mug, Cup"];\n'
        "}\n"
    )


def test_dot_quotes_what_a_name_may_hold():
    name = "c-clamp \\d"
    dot = build_automaton(f'F "{name}"').to_dot()
    assert 'label="F \\"c-clamp \\\\d\\""' in dot and '0 -> 1 [label="c-clamp \\\\d"]' in dot


def test_travels_to_other_processes():
    automaton = build_automaton(make_formula("or_seq", list("abcd")))
    automaton.includes  # noqa: B018 - what is cached travels too
    copy = pickle.loads(pickle.dumps(automaton))
    for name in ("transitions", "accepting", "advancing", "steps_to_accept", "includes"):
        assert (getattr(copy, name) == getattr(automaton, name)).all()
    assert (copy.formula, copy.propositions, copy.sink, copy.initial) == (
        automaton.formula,
        automaton.propositions,
        automaton.sink,
        automaton.initial,
    )


def test_building_twice_gives_the_same_numbers():
    for name, template in TEMPLATES.items():
        formula = make_formula(name, list("abcd"[: template.arity]))
        one, other = build_automaton(formula), build_automaton(formula)
        assert one.transitions.tolist() == other.transitions.tolist()


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("F (a & !a)", "no order of interactions does this task"),
        ("F (a & b)", "for both of two objects write 'F a & F b'"),
        ("(!a U b) & (!b U a)", "no order of interactions"),
        ("false", "no order of interactions"),
        ("true", "done before anything is done"),
        ("a | !a", "done before anything is done"),
        ("F (a | !a)", "done before anything is done"),
    ],
)
def test_what_nobody_can_do_and_what_needs_nobody_are_no_tasks(formula, said):
    with pytest.raises(FormulaError, match=said):
        check_task(build_automaton(formula))


@pytest.mark.parametrize("formula", ["F a", "!a U b", "X X a", "F (a & X (b & X a))"])
def test_what_somebody_must_do_is_a_task(formula):
    automaton = build_automaton(formula)
    assert check_task(automaton) is automaton
