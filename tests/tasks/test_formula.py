import pickle

import pytest

from mrtask.errors import InputError
from mrtask.tasks.formula import (
    MAX_NESTING,
    And,
    Constant,
    Eventually,
    FormulaError,
    Implies,
    Next,
    Not,
    Or,
    Proposition,
    Until,
    check_names,
    parse,
    proposition_names,
    push_negations,
    written,
)

a, b, c, d = (Proposition(name) for name in "abcd")
OBJECTS = ("Mug", "RemoteControl", "Laptop")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a", a),
        ("true", Constant(True)),
        ("RemoteControl_2", Proposition("RemoteControl_2")),
        ("Fa", Proposition("Fa")),
        ("F a", Eventually(a)),
        ("F(a)", Eventually(a)),
        ("X X!a", Next(Next(Not(a)))),
        ("!b U a", Until(Not(b), a)),
        ("F a U b", Until(Eventually(a), b)),
        ("a U b U c", Until(a, Until(b, c))),
        ("(a U b) U c", Until(Until(a, b), c)),
        ("a & b & c", And((a, b, c))),
        ("a | b & c | d", Or((a, And((b, c)), d))),
        ("a U b & c", And((Until(a, b), c))),
        ("a -> b -> c", Implies(a, Implies(b, c))),
        ("a | b -> c & d", Implies(Or((a, b)), And((c, d)))),
        ("  F\n\ta ", Eventually(a)),
        ('F "c-clamp" & "F" U"a"', And((Eventually(Proposition("c-clamp")), Until(Proposition("F"), a)))),
    ],
)
def test_parse_binds_as_documented(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize(
    ("text", "message", "position"),
    [
        ("", "the formula is empty: a formula has object names, true, false, ! & | -> X F U and parentheses", 1),
        (" \n", "the formula is empty", 1),
        ("F Mug & & F Laptop", "expected an object name, true, false, ! X F or '(', found '&'", 9),
        ("F Mug & ", "expected an object name, true, false, ! X F or '(', found the end", 8),
        ("F", "found the end", 2),
        ("F U Mug", "found 'U'", 3),
        ("F Mug Laptop", "expected an operator (& | -> U) or the end, found 'Laptop'", 7),
        ("(F Mug F Laptop)", "expected an operator (& | -> U) or ')', found 'F'", 8),
        ("F Mug & (F Laptop", "this '(' is never closed", 9),
        ("F Mug) & F Laptop", "this ')' closes nothing", 6),
        ("()", "found ')'", 2),
        ("F Mug % Laptop", "unexpected character '%'", 7),
        ("F 2Mug", "unexpected character '2'", 3),
        ("F Mug - > F Laptop", "unexpected character '-'", 7),
        ("F Mug-2", """a name with other signs stands in double quotes, as in F "c-clamp\"""", 6),
        ("F c-clamp", "unexpected character '-', did you mean \"c-clamp\"?", 4),
        ("F Mug & F spray bottle", """unknown object 'spray', did you mean '"spray bottle"'?""", 11),
        ('F "c-clam"', """unknown object 'c-clam', did you mean '"c-clamp"'?""", 3),
        ('F "c-clamp', "this double quote is never closed", 3),
        ('F " "', "a name cannot be empty", 3),
        ('F "a\nb"', r"the name 'a\nb' holds '\n'; names have no double quotes and control characters", 3),
        ("XF Mug", "unknown object 'XF', did you mean 'X F'?", 1),
        ("XF(Mug)", "unknown object 'XF', did you mean 'X F'?", 1),
        ("F Mig", "unknown object 'Mig', did you mean 'Mug'?; allowed: Laptop, Mug, RemoteControl, c-clamp", 3),
        ("F remotecontrol", "unknown object 'remotecontrol', did you mean 'RemoteControl'?", 3),
        ("F Zebra", "unknown object 'Zebra'; allowed: Laptop, Mug, RemoteControl, c-clamp", 3),
        ("F Mug & FLaptop", "unknown object 'FLaptop', did you mean 'F Laptop'?", 9),
        ("XFMug", "unknown object 'XFMug', did you mean 'X F Mug'?", 1),
        ("MugULaptop", "unknown object 'MugULaptop', did you mean 'Mug U Laptop'?", 1),
        ("G Mug", "not co-safe: G asks for something at all times, and no finite run completes that", 1),
        ("F Mug & !F Laptop", "not co-safe: this F stands under a negation (or left of ->), which asks for", 10),
        ("!(Mug U Laptop)", "not co-safe: this U stands under a negation (or left of ->)", 7),
        ("F Mug -> Laptop", "say what must not happen before what, as in '!b U a'", 1),
        ("!(Mug & X (Laptop | F Mug))", "not co-safe: this F", 21),
        ("!!!F Mug", "not co-safe: this F", 4),
        ("(" * 101 + "Mug" + ")" * 101, f"nested deeper than {MAX_NESTING} levels", 101),
        ("X " * 5000 + "Mug", f"nested deeper than {MAX_NESTING} levels", 201),
        ("Mug U " * 5000 + "Mug", f"nested deeper than {MAX_NESTING} levels", 605),
    ],
)
def test_errors_say_what_and_where(text, message, position):
    with pytest.raises(FormulaError) as caught:
        parse(text, (*OBJECTS, "c-clamp", "spray bottle"))
    assert message in caught.value.message
    assert caught.value.position == position


def test_error_draws_a_caret_under_the_position():
    with pytest.raises(FormulaError) as caught:
        parse("F Mug &\n\t& F Laptop")
    assert str(caught.value) == (
        "expected an object name, true, false, ! X F or '(', found '&' (position 10)\n"
        "  F Mug &  & F Laptop\n"
        "           ^"
    )
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_error_lists_no_more_names_than_one_reads():
    with pytest.raises(FormulaError, match=r"allowed: o10, o11, .*o29, \.\.\. \(83 in all\)"):
        parse("F Mug", [f"o{number}" for number in range(10, 93)])


@pytest.mark.parametrize(
    "text",
    ["!X a", "!!F a", "a -> F b", "!(F a -> b) | c", "!(a -> !F b)", "!(!F a | b)", "(" * 99 + "F a" + ")" * 99],
)
def test_co_safe_formulas_pass_however_they_are_written(text):
    parse(text)


def test_push_negations_leaves_them_on_propositions_only():
    assert push_negations(parse("!(a & X (b | !c) | false)")) == And(
        (Or((Not(a), Next(And((Not(b), c))))), Constant(True))
    )
    assert push_negations(parse("!(F a -> b) | c")) == Or((And((Until(Constant(True), a), Not(b))), c))
    with pytest.raises(ValueError, match="not co-safe"):
        push_negations(Not(Eventually(a)))


def test_proposition_names_are_in_order_of_appearance():
    assert proposition_names(parse("(c -> X a) & F b | (true & a U d)")) == ("c", "a", "b", "d")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["Mug", 'a"b'], """the name 'a"b' holds '"'; names have no double quotes and control characters"""),
        (["Mug", "a\n"], r"the name 'a\\n' holds"),
        (["\ud800"], r"the name '\\ud800' holds"),
        ([" "], "a name cannot be empty"),
        (["Mug", "Pen", "Mug"], "object name 'Mug' is given twice"),
        ("Mug", r"must be a collection of names, not the one string 'Mug'; write \['Mug'\]"),
    ],
)
def test_names_unfit_for_formulas_are_refused(names, message):
    with pytest.raises(ValueError, match=message) as refused:
        check_names(names)
    assert isinstance(refused.value, InputError) == ("Mug" not in message)


def test_operators_without_spaces_are_told_where_any_name_is_allowed():
    for text in ("XF Mug", "F Mug & FX (Mug)"):
        with pytest.raises(FormulaError, match=r"found '.*'; did you mean '(X F|F X)' for '(XF|FX)'\?"):
            parse(text)


@pytest.mark.parametrize("name", ["Mug", "Größe_2", "c-clamp", "2 mugs", "X", "true", "a & b", "a,b", "child's", "$x$"])
def test_every_fit_name_can_be_written_in_a_formula(name):
    assert parse(f"F {written(name)} & F a", [name, "a"]) == And((Eventually(Proposition(name)), Eventually(a)))
    assert (written(name) == name) == (name in ("Mug", "Größe_2"))


def test_names_keep_their_order_unless_they_have_none():
    assert check_names(["b", "a"]) == ("b", "a")
    assert check_names({name: None for name in ("b", "a")}) == ("b", "a")
    assert check_names({"b", "a", "c"}) == ("a", "b", "c")
