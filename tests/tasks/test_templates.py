import pytest

from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.formula import parse
from mrtask.tasks.templates import AUTHORS_TEMPLATES, PAPER_TEMPLATES, TEMPLATES, make_formula
from tests.tasks.naive_ltl import TEMPLATE_FORMULAS, good_words, text_of, words

# For each template, words that complete it (with no shorter prefix doing so) and words that do not.
EXPECTED = {
    "and2": (["ab", "ba", "aaab"], ["", "aa", "b"]),
    "and3": (["abc", "cba", "bbac"], ["ab", "aabb"]),
    "and_or": (["ab", "ac", "ba", "bca"], ["a", "bc", "cb"]),
    "seq2": (["ab", "aab"], ["ba", "bab", "a"]),
    "seq3": (["abc", "aabbc"], ["acb", "bac", "abab", "cabc"]),
    "or_seq": (["acd", "bcd", "abcd", "bacccd", "acabd"], ["a", "b", "ab", "cad", "adcd", "acb", "cd", "dacd"]),
    "one": (["a"], [""]),
    "or2": (["a", "b"], [""]),
    "seq2_back": (["ba", "bba"], ["ab", "aba", "b"]),
    "and4": (["abcd", "dcba", "aabdbc"], ["abc", "ddda"]),
}
SINKS = dict.fromkeys(EXPECTED, "") | {"seq2": "b", "seq3": "ac", "or_seq": "ad", "seq2_back": "a"}
STATES = {"and2": 4, "and3": 8, "and_or": 4, "seq2": 4, "seq3": 5, "or_seq": 5}
STATES |= {"one": 2, "or2": 2, "seq2_back": 4, "and4": 16}


def test_there_are_the_six_templates_of_the_paper_and_the_nine_of_its_authors_code():
    assert list(TEMPLATES) == list(EXPECTED)
    assert [TEMPLATES[name].arity for name in PAPER_TEMPLATES] == [2, 3, 3, 2, 3, 4]
    assert [TEMPLATES[name].arity for name in AUTHORS_TEMPLATES] == [1, 2, 2, 2, 2, 3, 3, 4, 4]
    assert [name for name, template in TEMPLATES.items() if template.name != name] == []


@pytest.mark.parametrize("name", TEMPLATES)
def test_template_means_what_its_hand_written_cases_say(name):
    letters = list("abcd"[: TEMPLATES[name].arity])
    automaton = build_automaton(make_formula(name, letters), letters)
    completing, others = EXPECTED[name]
    for word in completing:
        assert automaton.accepting[automaton.run(word)], word
        assert not automaton.accepting[automaton.run(word[:-1])], word
    for word in others:
        assert not automaton.accepting[automaton.run(word)], word
    assert len(automaton.transitions) == STATES[name]
    assert (automaton.sink == -1) == (SINKS[name] == "")
    if SINKS[name]:
        assert automaton.run(SINKS[name]) == automaton.sink


@pytest.mark.parametrize("name", TEMPLATES)
def test_template_agrees_with_the_definition_on_all_words(name):
    letters = "abcd"[: TEMPLATES[name].arity]
    formula = TEMPLATE_FORMULAS[name]
    assert parse(make_formula(name, list(letters))) == parse(text_of(formula))
    automaton = build_automaton(make_formula(name, list(letters)))
    accepted = {word for word in words(letters, 5) if automaton.accepting[automaton.run(word)]}
    assert accepted == good_words(formula, letters, 5, stem_length=1)


def test_or_seq_needs_the_brackets_that_the_papers_listing_omits():
    listing = "((!c & !d) U a) | ((!c & !d) U b) & (!d U c) & F d"
    misread = build_automaton(listing, ["a", "b", "c", "d"])
    ours = build_automaton(make_formula("or_seq", ["a", "b", "c", "d"]))
    assert misread.accepting[misread.run(["a"])]
    assert not ours.accepting[ours.run(["a"])]
    assert ours.steps_to_accept[ours.initial] == 3


def test_the_authors_order_of_three_is_seq3_without_a_clause_that_says_nothing_new():
    theirs = build_automaton("(!b U a) & (!c U b) & F c", ["a", "b", "c"])
    ours = build_automaton(make_formula("seq3", ["a", "b", "c"]), ["a", "b", "c"])
    assert theirs.transitions.tolist() == ours.transitions.tolist()
    assert theirs.accepting.tolist() == ours.accepting.tolist()


def test_make_formula_puts_the_objects_in_order():
    assert make_formula("seq2", ["Mug", "RemoteControl"]) == "(!RemoteControl U Mug) & F RemoteControl"
    assert make_formula("seq2", ["Mug", "c-clamp"]) == '(!"c-clamp" U Mug) & F "c-clamp"'


@pytest.mark.parametrize(
    ("template", "objects", "message"),
    [
        ("and5", ["Mug"], "unknown template 'and5'; allowed: and2, and3, and_or, seq2, seq3, or_seq, one"),
        ("and2", ["Mug"], r"template 'and2' \(a and b\) takes 2 objects, not 1: Mug"),
        ("and2", [], "takes 2 objects, not 0: none"),
        ("seq2", ["Mug", "Mug"], "object name 'Mug' is given twice"),
        ("seq2", ["Mug", 'Spray "Bottle"'], "the name 'Spray .*' holds '\"'"),
    ],
)
def test_make_formula_refuses_what_does_not_fit(template, objects, message):
    with pytest.raises(ValueError, match=message):
        make_formula(template, objects)
