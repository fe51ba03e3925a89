"""Tasks in words: what they mean against the templates and naive evaluation, and what is refused with its readings."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrtask.errors import InputError
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.formula import FormulaError
from mrtask.tasks.templates import TEMPLATES, make_formula
from mrtask.tasks.words import WordsError, read_task

OBJECTS = ["Pillow", "RemoteControl", "Laptop", "Television", "TVGuide", "CD"]


def same(one: str, other: str, letters: str) -> bool:
    first, second = build_automaton(one, letters), build_automaton(other, letters)
    return np.array_equal(first.transitions, second.transitions) and np.array_equal(first.accepting, second.accepting)


@pytest.mark.parametrize(
    ("text", "template"),
    [
        ("a and b", "and2"),
        ("a, b and c", "and3"),
        ("a, b, and c", "and3"),
        ("a and b and c", "and3"),
        ("a, and b or c", "and_or"),
        ("a and (b or c)", "and_or"),
        ("a then b", "seq2"),
        ("First the a, then the b", "seq2"),
        ("a then b then c", "seq3"),
        ("a, then b, then c", "seq3"),
        ("a or b, then c, then d", "or_seq"),
        ("(a or b) then c then d", "or_seq"),
        ("Find the a or b. Then c. Then d.", "or_seq"),
    ],
)
def test_words_mean_what_the_papers_templates_mean(text, template):
    letters = "abcd"[: TEMPLATES[template].arity]
    read = read_task(text)
    assert sorted(read.propositions) == list(letters)
    assert same(read.formula, make_formula(template, list(letters)), list(letters)), read.formula


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        ("a and b or c", {"(a and b) or c", "a and (b or c)"}),
        ("a or b then c", {"(a or b) then c", "a or (b then c)"}),
        ("a and b then c", {"(a and b) then c", "a and (b then c)"}),
        ("a then b and c", {"a then (b and c)", "(a then b) and c"}),
        ("a, and b, or c", {"a and (b or c)", "(a and b) or c"}),
        ("a, b and c or d", {"(a and b and c) or d", "a and b and (c or d)", "a and ((b and c) or d)"}),
        ("a, b", {"a and b", "a or b", "a then b"}),
        ("a, b, then c", {"a and b", "a or b", "a then b"}),
    ],
)
def test_ambiguous_words_are_refused_with_their_readings(text, readings):
    with pytest.raises(WordsError) as refused:
        read_task(text)
    assert set(refused.value.readings) == readings
    for reading in readings:
        assert reading in str(refused.value)
        read_task(reading)  # each of them is a task that is not refused


def runs(letters, longest):
    return [word for length in range(longest + 1) for word in product(letters, repeat=length)]


def meets(tree, word):
    """Whether a run has done a tree of ``("and" | "or" | "then", *trees)``, names and ``("bring", object, place)``,
    straight from its meaning: when it was done first, and nothing of a later stage before."""
    return done_at(tree, word) is not None


def done_at(tree, word):
    """How many letters of the run it took; None if it is not done or an order was broken."""
    if isinstance(tree, str):
        return word.index(tree) + 1 if tree in word else None
    kind, *parts = tree
    if kind == "bring":
        taken = done_at(parts[0], word)
        later = taken and done_at(parts[1], word[taken:])
        return taken + later if later else None
    times = [done_at(part, word) for part in parts]
    if kind == "or":
        return min((time for time in times if time is not None), default=None)
    if any(time is None for time in times):
        return None
    if kind == "and":
        return max(times)
    for index, time in enumerate(times):
        later = [name for part in parts[index + 1 :] for name in named(part)]
        if any(name in word[:time] for name in later):
            return None
    return max(times)


def named(tree):
    if isinstance(tree, str):
        return [tree]
    return [tree[1]] if tree[0] == "bring" else [name for part in tree[1:] for name in named(part)]


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        ("a or b, then c", ("then", ("or", "a", "b"), "c")),
        ("a and b, then c", ("then", ("and", "a", "b"), "c")),
        ("(a then b) and c", ("and", ("then", "a", "b"), "c")),
        ("a, then b or c", ("then", "a", ("or", "b", "c"))),
        ("bring a to c", ("bring", "a", "c")),
        ("b, then put the a on the c", ("then", "b", ("bring", "a", "c"))),
        ("bring a to c and bring b to c", ("and", ("bring", "a", "c"), ("bring", "b", "c"))),
        ("bring a to c, then b", ("then", ("bring", "a", "c"), "b")),
    ],
)
def test_words_are_done_when_their_meaning_is(text, tree):
    automaton = build_automaton(read_task(text).formula, list("abc"))
    for word in runs("abc", 6):
        assert bool(automaton.accepting[automaton.run(word)]) == meets(tree, word), word


def test_names_are_matched_in_words_and_unclear_ones_refused():
    read = read_task("the remote control and the pillow", OBJECTS)
    assert read.propositions == ("RemoteControl", "Pillow")
    assert read_task("remote", OBJECTS).formula == "F RemoteControl"
    assert read_task("remote control").propositions == ("remote_control",)
    with pytest.raises(WordsError, match="'wallet' is not an object here; allowed: CD, Laptop, Pillow"):
        read_task("wallet", OBJECTS)
    with pytest.raises(WordsError, match="did you mean 'pillow'") as refused:
        read_task("pilow", OBJECTS)
    with pytest.raises(WordsError, match="give the name in full") as refused:
        read_task("control", [*OBJECTS, "ControlPanel"])
    assert refused.value.readings == ("ControlPanel", "RemoteControl")


def test_deliveries_name_their_places():
    read = read_task("bring the pillow to the sofa, then the laptop", OBJECTS, ["sofa", "bed"])
    assert (read.propositions, read.places) == (("Pillow", "Laptop", "sofa"), ("sofa",))
    with pytest.raises(WordsError, match="'garage' is not a place here"):
        read_task("bring the pillow to the garage", OBJECTS, ["sofa"])
    with pytest.raises(WordsError, match="where is Pillow to be brought"):
        read_task("bring the pillow and the laptop to the sofa", OBJECTS, ["sofa"])


@pytest.mark.parametrize("text", ["XF Pillow", "XF(Pillow)", "FX Pillow"])
@pytest.mark.parametrize("objects", [None, OBJECTS])
def test_operators_without_spaces_are_no_objects(text, objects):
    with pytest.raises(FormulaError, match=rf"did you mean '{text[0]} {text[1]}'"):
        read_task(text, objects)


def test_formulas_pass_unchanged_and_keep_their_errors():
    formula = "(!Pillow U Laptop) & F Pillow"
    assert read_task(formula, OBJECTS).formula == formula
    for formula in ("F (Pillow & !Pillow)", "true"):
        with pytest.raises(FormulaError, match="this task"):
            read_task(formula, OBJECTS)
    with pytest.raises(FormulaError, match="did you mean 'Pillow'"):
        read_task("F Pilow", OBJECTS)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an object is missing before the end"),
        ("a and", "an object is missing before the end"),
        ("a and or b", "an object is missing before 'or'"),
        ("(a and b", r"'\(' is never closed"),
        ("a and b)", r"'\)' closes nothing"),
        ("a (b)", "is missing before"),
        (
            "a; b",
            "unexpected ';'; words, commas, full stops and brackets are allowed, and any sign in a name",
        ),
        ("bring a to c. Bring b to c.", "what does the full stop stand for\\? Put 'and', 'or' or 'then' after it"),
        ("a then b then a", r"a comes twice, and a task cannot ask for two of a kind; .* as in 'F \(a & X F a\)'"),
        ('red "c-clamp"', "a name in double quotes stands alone"),
        ('"" then b', "a name cannot be empty"),
        ("2 mugs", "'2 mugs' cannot be read as an object"),
        ("F a & F XFMug", "'XFMug' looks like operators without spaces, did you mean 'X F Mug'\\?"),
        ("F FXx", "did you mean 'F Xx'\\? In double quotes it is a name: \"FXx\""),
        ("bring a to b then b", "b comes twice"),
        (" and ".join("abcdefghijk"), "more than 10 objects"),
        ("x" * 501, "longer than 500"),
    ],
)
def test_mistakes_are_told(text, said):
    with pytest.raises(WordsError, match=said):
        read_task(text)


@given(
    st.lists(st.sampled_from(["and", "or", "then", ",", "(", ")", "a", "b", "c", "to", "bring", "the"]), max_size=25)
)
def test_any_text_is_a_task_or_refused(words):
    try:
        read = read_task(" ".join(words))
    except ValueError:
        return
    build_automaton(read.formula, read.propositions)


@pytest.mark.parametrize(
    "text",
    [
        "avoid the red room",
        "slice the apple",
        "put all mugs on the desk",
        "take the coke from the kitchen to the desk",
        "find the mug and bring it to the desk",
        "open the fridge and mug",
        "very small old red mug",
    ],
)
def test_without_a_list_of_objects_sentences_are_no_names(text):
    with pytest.raises(WordsError, match="cannot be read as an object; a name has up to 3 words, as in 'red mug'"):
        read_task(text)
    read_task(text, places=["desk"], checked_later=True)


def test_names_of_few_words_need_no_list():
    assert read_task("the red mug, then my_open_box").propositions == ("red_mug", "my_open_box")
    assert read_task("open box", ["OpenBox"]).propositions == ("OpenBox",)
    assert read_task('find "the red room", then "FMug".').propositions == ("the red room", "FMug")
    assert read_task('F "FMug"').propositions == ("FMug",)


def test_names_with_other_signs_are_objects_and_places_like_all_others():
    names, places = ["c-clamp", "remote control", "mug (red)", "X"], ["desk-1", "side table"]
    read = read_task("Bring the c-clamp to desk 1, then put the remote on the side table.", names, places)
    assert read.propositions == ("c-clamp", "remote control", "desk-1", "side table")
    assert read.places == ("desk-1", "side table")
    quoted = read_task('bring "c-clamp" to "desk-1", then put "remote control" on "side table"', names, places)
    assert quoted == read == replace(read_task(read.formula, names, places), propositions=read.propositions)
    assert read_task('mug and "X"', names).formula == 'F "mug (red)" & F "X"'
    with pytest.raises(WordsError, match="'c clam' is not an object here, did you mean 'c-clamp'\\?"):
        read_task('"c clam"', names)


def test_deliveries_without_places_are_refused_with_where_there_are_some():
    with pytest.raises(WordsError, match="no places to deliver to: live teams and scenarios know containers by name"):
        read_task("bring the pillow to the desk", OBJECTS, ())


@given(st.text('ab "(),.-_1Xand', max_size=12), st.text("ab \"'$&|()-_1X", min_size=1, max_size=5))
def test_any_text_and_any_name_is_a_task_or_refused(text, name):
    for listed in (None, [name, "a"]):
        try:
            read = read_task(text, listed)
        except InputError:
            continue
        assert build_automaton(read.formula, read.propositions).propositions == read.propositions
