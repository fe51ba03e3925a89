"""Parse co-safe LTL task formulas, with errors that point at the offending character.

The grammar, from the tightest binding to the loosest: ``! X F`` (unary), ``U`` (right-associative), ``&``, ``|``,
``->`` (right-associative); ``true``, ``false``, parentheses and object names. A name that is not just letters, digits
and ``_``, or that is a word of the grammar, stands in double quotes: ``F "c-clamp"``. A formula is accepted if it is
syntactically co-safe (Kupferman and Vardi, *Model Checking of Safety Properties*, 2001): when its negations are pushed
inward, none remains in front of ``F`` or ``U``, so each satisfying run satisfies it after finitely many letters.
"""

import difflib
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from mrtask.errors import InputError
from mrtask.names import check_name

RESERVED_WORDS = ("X", "F", "U", "G", "true", "false")
MAX_NESTING = 100
"""The deepest nesting of parentheses and operators, well inside Python's recursion limit."""
NAMES_SHOWN = 20
"""The number of allowed names that an error lists before it only counts them."""

_NAME = re.compile(r"[^\W\d]\w*")
_QUOTE = '"'
_TOKEN = re.compile(r'[^\W\d]\w*|->|[!&|()]|"[^"]*"')
_GLUED = re.compile(r"[XF]{2,}")
"""Two and more operators without spaces between, which read as a name."""
_BINDING = {"->": 1, "|": 2, "&": 3, "U": 4}
_GRAMMAR = "a formula has object names, true, false, ! & | -> X F U and parentheses"
_QUOTING = 'a name with other signs stands in double quotes, as in F "c-clamp"'
_NEVER_COMPLETED = (
    "asks for something at all times, and no finite run completes that (only co-safe formulas make tasks); "
    "say what must not happen before what, as in '!b U a'"
)


class FormulaError(InputError):
    """A formula that is not a task. It says what is wrong and the ``position`` (from 1), with a caret under it."""

    def __init__(self, message: str, text: str, position: int) -> None:
        super().__init__(message, text, position)
        self.message = message
        self.text = text
        self.position = position

    def __str__(self) -> str:
        line = re.sub(r"\s", " ", self.text)
        return f"{self.message} (position {self.position})\n  {line}\n  {' ' * (self.position - 1)}^"


@dataclass(frozen=True)
class Node:
    """The base of all parts of a formula: the ``position`` in the text for errors, which equality ignores."""

    position: int = field(default=1, compare=False, repr=False, kw_only=True)


@dataclass(frozen=True)
class Constant(Node):
    """``true`` or ``false``."""

    value: bool


@dataclass(frozen=True)
class Proposition(Node):
    """``name``: this letter is the interaction with that object."""

    name: str


@dataclass(frozen=True)
class Not(Node):
    """``! operand``."""

    operand: "Formula"


@dataclass(frozen=True)
class And(Node):
    """All ``operands``."""

    operands: tuple["Formula", ...]


@dataclass(frozen=True)
class Or(Node):
    """One or more of the ``operands``."""

    operands: tuple["Formula", ...]


@dataclass(frozen=True)
class Implies(Node):
    """``left -> right``."""

    left: "Formula"
    right: "Formula"


@dataclass(frozen=True)
class Next(Node):
    """``X operand``: holds from the next letter on."""

    operand: "Formula"


@dataclass(frozen=True)
class Eventually(Node):
    """``F operand``: holds from this letter or a later one on."""

    operand: "Formula"


@dataclass(frozen=True)
class Until(Node):
    """``left U right``: ``right`` holds from this letter or a later one on, and ``left`` from each letter before."""

    left: "Formula"
    right: "Formula"


Formula = Constant | Proposition | Not | And | Or | Implies | Next | Eventually | Until


def parse(text: str, propositions: Collection[str] | None = None) -> Formula:
    """Parse a co-safe formula.

    Args:
        text: The formula.
        propositions: The object names that may occur; ``None`` allows every name.

    Raises:
        FormulaError: The text is not a formula, names an unknown object, or is not co-safe.
    """
    formula = _Parser(text, propositions).parse()
    try:
        push_negations(formula)
    except _NotCoSafe as error:
        raise FormulaError(f"not co-safe: {error.reason}", text, error.position) from None
    return formula


def push_negations(formula: Formula, negated: bool = False) -> Formula:
    """Return the equivalent formula (of the negation if ``negated``) with its negations pushed inward.

    It consists of constants, propositions, negated propositions, ``And``, ``Or``, ``Next`` and ``Until``; ``F a``
    becomes ``true U a``.

    Raises:
        ValueError: A negation stays in front of ``F`` or ``U``; ``parse`` has refused such a formula.
    """
    match formula:
        case Constant(value):
            return replace(formula, value=value != negated)
        case Proposition():
            return Not(formula) if negated else formula
        case Not(operand):
            return push_negations(operand, not negated)
        case And(operands) | Or(operands):
            parts = tuple(push_negations(operand, negated) for operand in operands)
            return And(parts) if isinstance(formula, And) != negated else Or(parts)
        case Implies(left, right):
            parts = (push_negations(left, not negated), push_negations(right, negated))
            return And(parts) if negated else Or(parts)
        case Next(operand):
            return Next(push_negations(operand, negated))
        case Eventually() | Until() if negated:
            raise _NotCoSafe(formula)
        case Eventually(operand):
            return Until(Constant(True), push_negations(operand))
        case Until(left, right):
            return Until(push_negations(left), push_negations(right))


def proposition_names(formula: Formula) -> tuple[str, ...]:
    """Return the names in a formula, each once, in order of appearance."""
    match formula:
        case Constant():
            return ()
        case Proposition(name):
            return (name,)
        case Not(operand) | Next(operand) | Eventually(operand):
            return proposition_names(operand)
        case And(operands) | Or(operands):
            parts = operands
        case Implies(left, right) | Until(left, right):
            parts = (left, right)
    return tuple(dict.fromkeys(name for part in parts for name in proposition_names(part)))


def check_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names as a tuple, in their order (sets are sorted), if formulas can use them as propositions.

    Raises:
        InputError: A name is empty, or holds a double quote or a control character.
        ValueError: A name is given twice.
    """
    if isinstance(names, str):
        raise ValueError(f"object names must be a collection of names, not the one string {names!r}; write [{names!r}]")
    checked = tuple(sorted(names)) if isinstance(names, (set, frozenset)) else tuple(names)
    for name in checked:
        check_name(name)
        if checked.count(name) > 1:
            raise ValueError(f"object name {name!r} is given twice; name each object once")
    return checked


def written(name: str) -> str:
    """Return a name as formulas write it: as it is, or in double quotes (``"c-clamp"``)."""
    return name if _NAME.fullmatch(name) and name not in RESERVED_WORDS else f"{_QUOTE}{name}{_QUOTE}"


class _NotCoSafe(ValueError):
    """A negated ``F`` or ``U``. Only ``parse`` knows the text to show."""

    def __init__(self, formula: Eventually | Until) -> None:
        operator = "F" if isinstance(formula, Eventually) else "U"
        self.reason = f"this {operator} stands under a negation (or left of ->), which {_NEVER_COMPLETED}"
        self.position = formula.position
        super().__init__(f"not co-safe: {self.reason}")


class _Parser:
    """A precedence-climbing parser over the tokens of one formula."""

    def __init__(self, text: str, propositions: Collection[str] | None) -> None:
        self.text = text
        self.propositions = propositions
        self.tokens = self._tokens()
        self.next = 0
        self.depth = 0

    def parse(self) -> Formula:
        if not self.text.strip():
            raise FormulaError(f"the formula is empty: {_GRAMMAR}", self.text, 1)
        formula = self._binary(1)
        token, position = self.tokens[self.next]
        if token == ")":
            raise self._error("this ')' closes nothing", position)
        if token:
            raise self._no_operator("the end", position)
        return formula

    def _tokens(self) -> list[tuple[str, int]]:
        """Return the tokens with their positions, then an empty token for the end."""
        tokens = []
        index = 0
        while index < len(self.text):
            if self.text[index].isspace():
                index += 1
            elif match := _TOKEN.match(self.text, index):
                tokens.append((match.group(), index + 1))
                index = match.end()
            elif self.text[index] == _QUOTE:
                raise self._error("this double quote is never closed", index + 1)
            else:
                meant = self._unquoted_name(index)
                hint = f", did you mean {meant}?" if meant else f": {_GRAMMAR}; {_QUOTING}"
                raise self._error(f"unexpected character {self.text[index]!r}{hint}", index + 1)
        return [*tokens, ("", len(self.text.rstrip()) + 1)]

    def _binary(self, loosest: int) -> Formula:
        """Parse operands joined by operators that bind at least as tightly as ``loosest``."""
        left = self._unary()
        while True:
            operator, position = self.tokens[self.next]
            binding = _BINDING.get(operator, 0)
            if binding < loosest:
                return left
            self.next += 1
            match operator:
                case "->" | "U":
                    with self._level(position):
                        right = self._binary(binding)
                    left = (Until if operator == "U" else Implies)(left, right, position=position)
                case "&":
                    joined = left.operands if isinstance(left, And) else (left,)
                    left = And((*joined, self._binary(binding + 1)), position=position)
                case _:
                    joined = left.operands if isinstance(left, Or) else (left,)
                    left = Or((*joined, self._binary(binding + 1)), position=position)

    def _unary(self) -> Formula:
        """Parse an operand with the ``!``, ``X`` and ``F`` in front of it."""
        token, position = self.tokens[self.next]
        self.next += bool(token)
        match token:
            case "!" | "X" | "F":
                with self._level(position):
                    operand = self._unary()
                if token == "!":
                    return Not(operand, position=position)
                return (Next if token == "X" else Eventually)(operand, position=position)
            case "G":
                raise self._error(f"not co-safe: G {_NEVER_COMPLETED}", position)
            case "true" | "false":
                return Constant(token == "true", position=position)
            case "(":
                with self._level(position):
                    formula = self._binary(1)
                closing, found_at = self.tokens[self.next]
                if not closing:
                    raise self._error("this '(' is never closed", position)
                if closing != ")":
                    raise self._no_operator("')'", found_at)
                self.next += 1
                return formula
        if token[:1] == _QUOTE or (_NAME.fullmatch(token) and token not in RESERVED_WORDS):
            name = token.strip(_QUOTE)
            self._check_fit(name, position)
            self._check_known(name, position)
            return Proposition(name, position=position)
        found = repr(token) if token else "the end"
        raise self._error(f"expected an object name, true, false, ! X F or '(', found {found}", position)

    @contextmanager
    def _level(self, position: int) -> Iterator[None]:
        if self.depth == MAX_NESTING:
            raise self._error(f"nested deeper than {MAX_NESTING} levels; drop brackets or split the formula", position)
        self.depth += 1
        yield
        self.depth -= 1

    def _no_operator(self, or_what: str, position: int) -> FormulaError:
        """Return the error that an operator is missing before the next token."""
        found, before = self.tokens[self.next][0], self.tokens[self.next - 1][0]
        glued = f"; did you mean {_apart(before)!r} for {before!r}?" if _GLUED.fullmatch(before) else ""
        return self._error(f"expected an operator (& | -> U) or {or_what}, found {found!r}{glued}", position)

    def _check_fit(self, name: str, position: int) -> None:
        try:
            check_name(name)
        except InputError as error:
            raise self._error(str(error), position) from None

    def _unquoted_name(self, index: int) -> str:
        """Return, in quotes, the allowed name that needs them and stands around this index of the text, or nothing."""
        for name in sorted(self.propositions or (), key=len, reverse=True):
            begins = self.text.rfind(name, 0, index + len(name))
            if begins >= 0 and begins <= index < begins + len(name) and written(name) != name:
                return written(name)
        return ""

    def _check_known(self, name: str, position: int) -> None:
        if self.propositions is None or name in self.propositions:
            return
        allowed = sorted(self.propositions)
        by_lower_case = {known.lower(): known for known in allowed}
        matches = difflib.get_close_matches(name.lower(), by_lower_case)
        suggestion = (
            self._unquoted_name(position - 1)
            or _split_operators(name, self.propositions)
            or (written(by_lower_case[matches[0]]) if matches else "")
        )
        more = f", ... ({len(allowed)} in all)" if len(allowed) > NAMES_SHOWN else ""
        raise self._error(
            f"unknown object {name!r}{f', did you mean {suggestion!r}?' if suggestion else ''}; "
            f"allowed: {', '.join(allowed[:NAMES_SHOWN]) or 'none'}{more}",
            position,
        )

    def _error(self, message: str, position: int) -> FormulaError:
        return FormulaError(message, self.text, position)


def _apart(operators: str) -> str:
    return " ".join(operators)


def _split_operators(word: str, allowed: Collection[str]) -> str:
    """Return ``F a`` for ``Fa``, ``a U b`` for ``aUb``, ``X F`` for ``XF`` (operators without spaces), or nothing."""
    if word in allowed:
        return word
    if _GLUED.fullmatch(word):
        return _apart(word)
    if word[:1] in ("X", "F") and (rest := _split_operators(word[1:], allowed)):
        return f"{word[0]} {rest}"
    for index, letter in enumerate(word):
        if letter == "U" and word[:index] in allowed and (rest := _split_operators(word[index + 1 :], allowed)):
            return f"{word[:index]} U {rest}"
    return ""
