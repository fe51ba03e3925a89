"""LTL by its textbook definition, to check the product against; it shares no code with it.

A formula is a nested tuple such as ``("U", ("!", "b"), "a")``; a string is a proposition, ``True`` and ``False`` are
the constants. A letter is the name of the one proposition that holds, ``None`` when none does, or the set of those that
hold.
"""

from itertools import product

BINDING = {"->": 1, "|": 2, "&": 3, "U": 4}
UNARY = 5


def holds(formula, stem, loop, at=0):
    """Whether the infinite word ``stem loop loop ...`` satisfies the formula from position ``at`` on."""
    length = len(stem) + len(loop)
    if at >= length:
        at = len(stem) + (at - len(stem)) % len(loop)
    if isinstance(formula, bool):
        return formula
    if isinstance(formula, str):
        letter = (*stem, *loop)[at]
        return formula in letter if isinstance(letter, frozenset) else formula == letter
    match formula:
        case ("!", one):
            return not holds(one, stem, loop, at)
        case ("&", *parts):
            return all(holds(part, stem, loop, at) for part in parts)
        case ("|", *parts):
            return any(holds(part, stem, loop, at) for part in parts)
        case ("->", one, other):
            return not holds(one, stem, loop, at) or holds(other, stem, loop, at)
        case ("X", one):
            return holds(one, stem, loop, at + 1)
        case ("F", one):
            return any(holds(one, stem, loop, later) for later in range(at, at + length))
        case ("U", one, other):
            for later in range(at, at + length):  # passes every position of the loop
                if holds(other, stem, loop, later):
                    return True
                if not holds(one, stem, loop, later):
                    return False
            return False
    raise ValueError(formula)


def is_good_prefix(formula, word, letters, stem_length=2):
    """Whether every continuation of the word satisfies the formula, tried with every stem up to that length and every
    loop of one letter, with an interaction with no proposition, or none at all, as a letter too."""
    letters = (None, *letters)
    return all(
        holds(formula, (*word, *stem), loop)
        for length in range(stem_length + 1)
        for stem in product(letters, repeat=length)
        for loop in product(letters, repeat=1)
    )


def shortest_good_prefix(formula, word, letters, stem_length=2):
    """The length of the word's shortest prefix that completes the task, ``None`` if none does."""
    for length in range(len(word) + 1):
        if is_good_prefix(formula, word[:length], letters, stem_length):
            return length
    return None


def words(letters, longest):
    return [word for length in range(longest + 1) for word in product(letters, repeat=length)]


def good_words(formula, letters, longest, stem_length=2):
    """All words up to that length that complete the task; a word does when one of its prefixes does."""
    good = set()
    for word in words(letters, longest):
        if word[:-1] in good or is_good_prefix(formula, word, letters, stem_length):
            good.add(word)
    return good


def text_of(formula, all_brackets=False):
    """The formula as text, with all brackets or only those that precedence asks for."""
    if isinstance(formula, bool):
        return str(formula).lower()
    if isinstance(formula, str):
        return formula
    operator, *parts = formula

    def part(index, loosest):
        inner = text_of(parts[index], all_brackets)
        compound = isinstance(parts[index], tuple)
        binding = BINDING.get(parts[index][0], UNARY) if compound else UNARY
        return f"({inner})" if compound and (all_brackets or binding < loosest) else inner

    if operator not in BINDING:
        return f"{operator} {part(0, UNARY)}"
    own = BINDING[operator]
    if operator in ("U", "->"):
        return f"{part(0, own + 1)} {operator} {part(1, own)}"
    return f" {operator} ".join(part(index, own) for index in range(len(parts)))


def either(*parts):
    return ("|", *parts)


def both(*parts):
    return ("&", *parts)


def before(first, *later):
    """None of ``later`` until ``first``."""
    return ("U", both(*(("!", name) for name in later)), first)


TEMPLATE_FORMULAS = {
    "and2": both(("F", "a"), ("F", "b")),
    "and3": both(("F", "a"), ("F", "b"), ("F", "c")),
    "and_or": both(("F", "a"), either(("F", "b"), ("F", "c"))),
    "seq2": both(before("a", "b"), ("F", "b")),
    "seq3": both(before("a", "c", "b"), before("b", "c"), ("F", "c")),
    "or_seq": both(either(before("a", "c", "d"), before("b", "c", "d")), before("c", "d"), ("F", "d")),
    "one": ("F", "a"),
    "or2": either(("F", "a"), ("F", "b")),
    "seq2_back": both(before("b", "a"), ("F", "a")),
    "and4": both(("F", "a"), ("F", "b"), ("F", "c"), ("F", "d")),
}
"""The templates, written by hand, over the propositions a, b, c, d."""
