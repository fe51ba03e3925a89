"""Read tasks in words: ``laptop or wallet, then remote, then tv`` and ``bring the mug to the sofa`` become formulas.

``and``, ``or`` and ``then`` join words for objects. A comma or a full stop in front of one of these binds loosest; a
comma in a list stands for the word at the list's end (``a, b and c``); brackets settle the rest. The reader tries every
way to bracket the text. If two ways give different tasks, it refuses the text and shows the readings that it could
have. A name in double quotes is taken as it stands.

``a then b`` is the template ``seq2``: b must not be done before a. A delivery is the interaction with the object and
later one with the place, which is a container's name; a formula cannot say that one robot does both.
"""

import difflib
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, pairwise, product
from typing import Literal

from mrtask.errors import InputError
from mrtask.names import check_name, name_to_text
from mrtask.tasks.automaton import build_automaton, check_task
from mrtask.tasks.formula import RESERVED_WORDS, written

MAX_CHARACTERS = 500
MAX_LEAVES = 10
"""The largest number of objects and deliveries in one text."""
READINGS_TRIED, READINGS_SHOWN = 64, 4
NAMES_SHOWN = 20
_OPERATORS: tuple["Operator", ...] = ("then", "or", "and")
_VERBS = ("bring", "deliver", "take", "carry", "put")
_TO = ("to", "on", "onto", "in", "into")
_IGNORED = ("the", "a", "an", "first", "please", "find", "reach")
_NO_NAME = frozenset(
    {
        "all", "any", "are", "at", "avoid", "by", "check", "clean", "close", "cool", "cut", "each", "every", "fetch",
        "for", "from", "get", "go", "grab", "heat", "is", "it", "its", "look", "move", "my", "near", "no", "of",
        "open", "pick", "place", "search", "slice", "some", "switch", "that", "them", "these", "they", "this",
        "those", "turn", "wash", "with", "without", "your",
    }
)  # fmt: skip
"""Words of sentences that are no names of objects, where no list says which names there are."""
MAX_NAME_WORDS = 3
"""Longer names are taken for sentences, likewise."""
_QUOTE = '"'
_QUOTED = re.compile(r'"[^"]*"')
_TOKEN = re.compile(rf"\w[\w\-]*|[,.()]|{_QUOTED.pattern}")
_FORMULA = re.compile(rf"[!&|]|->|(?<!\w)({'|'.join(RESERVED_WORDS)}|[XF]{{2,}})(?!\w)")
_GLUED_NAME = re.compile(r"([XF]+)([A-Z]\w*)")
"""A name that looks like operators without a space before a name: ``FMug``."""

_MARKS = ("", ",", ".", "(", ")")
"""What ends a name, apart from some words; the first is the end of the text."""

Operator = Literal["and", "or", "then"]


class WordsError(InputError):
    """A text that is not exactly one task. If it is several, ``readings`` holds some, with brackets written out."""

    def __init__(self, message: str, text: str, readings: Sequence[str] = ()) -> None:
        self.readings = tuple(readings)
        listed = "".join(f"\n  {reading}" for reading in readings)
        super().__init__(f"task {text!r}: {message}{listed}")


@dataclass(frozen=True)
class ReadTask:
    """A task as a formula. ``places`` are the containers among the propositions, to which something is delivered."""

    formula: str
    propositions: tuple[str, ...]
    places: tuple[str, ...] = ()


def _spoken(name: str) -> str:
    """Return a name so that it is read as this name again."""
    special = name.lower() in (*_OPERATORS, *_TO)
    return name if _TOKEN.fullmatch(name) and not special else f"{_QUOTE}{name}{_QUOTE}"


@dataclass(frozen=True)
class _Leaf:
    """An interaction with an object or, with a ``place``, a delivery to it."""

    name: str
    place: str = ""

    def words(self) -> str:
        name = _spoken(self.name)
        return f"bring {name} to {_spoken(self.place)}" if self.place else name

    def leaves(self) -> list["_Leaf"]:
        return [self]


@dataclass(frozen=True)
class _Joined:
    """Two or more parts under one operator, which none of the parts has itself."""

    operator: Operator
    parts: tuple["_Tree", ...]

    def words(self) -> str:
        parts = [f"({part.words()})" if isinstance(part, _Joined) else part.words() for part in self.parts]
        return f" {self.operator} ".join(parts)

    def leaves(self) -> list[_Leaf]:
        return [leaf for part in self.parts for leaf in part.leaves()]


_Tree = _Leaf | _Joined


@dataclass(frozen=True)
class _Link:
    """What stands between two items. ``operator`` is None for a comma alone; ``loose`` means that it has a comma."""

    operator: Operator | None
    loose: bool


@dataclass(frozen=True)
class _Group:
    """Items with the links between them: the contents of one pair of brackets."""

    items: tuple["_Leaf | _Group", ...]
    links: tuple[_Link, ...]


def read_task(
    text: str,
    objects: Collection[str] | None = None,
    places: Collection[str] | None = None,
    *,
    checked_later: bool = False,
) -> ReadTask:
    """Read a task from a formula or from words.

    A text with a sign that only formulas have (``! & | ->``, ``F U X G true false``) outside of double quotes is a
    formula; any other text is words.

    Args:
        objects: the names that objects may have; words are matched with them (``remote control`` is ``RemoteControl``,
            and so is ``remote`` where no other name has that word). None allows every name, its words joined by ``_``,
            but refuses what looks like a sentence or like operators unless it stands in double quotes.
        places: likewise the containers to which something may be delivered. None allows every name; with an empty
            collection, deliveries are refused.
        checked_later: with ``objects`` None, do not even refuse those, since the text is read again with the names.

    Raises:
        FormulaError: the text is a formula with a mistake, cannot be done, or is done before anything is.
        WordsError: the text is not a task in words, has an unknown name, or has more than one meaning.
    """
    if _FORMULA.search(_QUOTED.sub("", text)):
        automaton = check_task(build_automaton(text))
        if objects is None and not checked_later:
            _refuse_glued_operators(text, automaton.propositions)
        allowed = None if objects is None else {*objects, *(places or ())}
        build_automaton(text, allowed)
        return ReadTask(text, automaton.propositions, tuple(n for n in automaton.propositions if n in (places or ())))
    group = _Parser(text, objects, places, checked_later).parse()
    tree = _only_meaning(text, group)
    leaves = tree.leaves()
    places_named = tuple(dict.fromkeys(leaf.place for leaf in leaves if leaf.place))
    names = [leaf.name for leaf in leaves]
    for one in names:
        if names.count(one) > 1 or one in places_named:
            again = f"F ({written(one)} & X F {written(one)})"
            raise WordsError(
                f"{one} comes twice, and a task cannot ask for two of a kind; a formula can ask to reach one again "
                f"later, as in {again!r}",
                text,
            )
    return ReadTask(_formula(tree, ()), (*names, *places_named), places_named)


def _refuse_glued_operators(text: str, names: Sequence[str]) -> None:
    """Raise ``WordsError`` for a name such as ``FMug``, unless the text has it in double quotes."""
    for name in names:
        glued = _GLUED_NAME.fullmatch(name)
        if glued and f"{_QUOTE}{name}{_QUOTE}" not in text:
            apart = " ".join([*glued[1], glued[2]])
            raise WordsError(
                f"{name!r} looks like operators without spaces, did you mean {apart!r}? In double quotes it is a name: "
                f"{_QUOTE}{name}{_QUOTE}",
                text,
            )


class _Parser:
    def __init__(
        self, text: str, objects: Collection[str] | None, places: Collection[str] | None, checked_later: bool
    ) -> None:
        self.text, self.objects, self.places, self.any_name = text, objects, places, checked_later
        if len(text) > MAX_CHARACTERS:
            raise WordsError(f"is longer than {MAX_CHARACTERS} characters; give a formula", text[:40] + "...")
        text = text.strip().removesuffix(".")
        if stray := _TOKEN.sub("", text).strip():
            raise WordsError(
                f"unexpected {stray[0]!r}; words, commas, full stops and brackets are allowed, and any sign in a "
                "name in double quotes",
                self.text,
            )
        self.tokens: list[str] = [match.group() for match in _TOKEN.finditer(text)] + [""]
        self.next = 0
        self.leaves = 0

    def parse(self) -> _Group:
        group = self._group()
        if self._peek() == ")":
            raise WordsError("a ')' closes nothing", self.text)
        return group

    def _peek(self) -> str:
        return self.tokens[self.next].lower()

    def _group(self) -> _Group:
        items, links = [self._item()], []
        while self._peek() not in ("", ")"):
            mark = self._peek()
            loose = mark in (",", ".")
            self.next += loose
            operator = next((one for one in _OPERATORS if one == self._peek()), None)
            self.next += operator is not None
            if mark == "." and operator is None:
                raise WordsError("what does the full stop stand for? Put 'and', 'or' or 'then' after it", self.text)
            if not loose and operator is None:
                raise WordsError(f"'and', 'or', 'then' or a comma is missing before {self._peek()!r}", self.text)
            links.append(_Link(operator, loose))
            items.append(self._item())
        return _Group(tuple(items), self._with_lists(links, items))

    def _item(self) -> "_Leaf | _Group":
        if self._peek() == "(":
            self.next += 1
            group = self._group()
            if self._peek() != ")":
                raise WordsError("a '(' is never closed", self.text)
            self.next += 1
            return group
        self.leaves += 1
        if self.leaves > MAX_LEAVES:
            raise WordsError(f"names more than {MAX_LEAVES} objects; give a formula", self.text)
        delivers = False
        while self._peek() in (*_IGNORED, *_VERBS) and self._goes_on():
            delivers |= self._peek() in _VERBS
            self.next += 1
        name = self._name("an object", self.objects)
        if not delivers:
            return _Leaf(name)
        if self.places is not None and not self.places:
            raise WordsError(
                "there are no places to deliver to: live teams and scenarios know containers by name, other tasks are "
                f"about objects alone, as in {_spoken(name)!r}",
                self.text,
            )
        if self._peek() not in _TO:
            raise WordsError(
                f"where is {name} to be brought? A delivery is one object to one place, as in 'bring {name} to sofa', "
                f"and several are joined: 'bring a to b and bring c to d'",
                self.text,
            )
        self.next += 1
        while self._peek() in _IGNORED and self._goes_on():
            self.next += 1
        return _Leaf(name, self._name("a place", self.places))

    def _goes_on(self) -> bool:
        """Return whether a name can still continue with the next word."""
        return self.tokens[self.next + 1].lower() not in (*_MARKS, *_OPERATORS, *_TO)

    def _name(self, what: str, allowed: Collection[str] | None) -> str:
        words: list[str] = []
        while self._peek() not in (*_MARKS, *_OPERATORS) and not (words and self._peek() in _TO):
            words.append(self.tokens[self.next])
            self.next += 1
        if not words:
            found = repr(self.tokens[self.next]) if self._peek() else "the end"
            raise WordsError(f"{what} is missing before {found}", self.text)
        return self._known(what, words, allowed)

    def _quoted(self, what: str, words: list[str], allowed: Collection[str] | None) -> str:
        """Return a name in double quotes, which says that it is just so."""
        name = words[0].strip(_QUOTE)
        if len(words) > 1:
            raise WordsError(f"{' '.join(words)!r}: a name in double quotes stands alone", self.text)
        if allowed is not None and name not in allowed:
            raise self._unknown(what, name, {one: one for one in sorted(allowed)})
        try:
            return check_name(name)
        except InputError as error:
            raise WordsError(str(error), self.text) from None

    def _known(self, what: str, words: list[str], allowed: Collection[str] | None) -> str:
        if any(word.startswith(_QUOTE) for word in words):
            return self._quoted(what, words, allowed)
        if allowed is None:
            joined = "_".join(words).replace("-", "_")
            said = {word.lower() for word in words}
            no_name = len(words) > MAX_NAME_WORDS or words[0][0].isdigit() or {*_NO_NAME, *_VERBS} & said
            if no_name and not self.any_name:
                raise WordsError(
                    f"{' '.join(words)!r} cannot be read as {what}; a name has up to {MAX_NAME_WORDS} words, as in "
                    "'red mug', and any name can stand in double quotes or in a list of objects",
                    self.text,
                )
            return joined
        wanted = name_to_text(" ".join(words))
        names = {name: name_to_text(name) for name in sorted(allowed)}
        fitting = [name for name, words_of in names.items() if words_of == wanted] or [
            name for name, words_of in names.items() if set(wanted.split()) <= set(words_of.split())
        ]
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            raise WordsError(f"{wanted!r} could be any of these; give the name in full", self.text, fitting)
        raise self._unknown(what, wanted, names)

    def _unknown(self, what: str, wanted: str, names: Mapping[str, str]) -> WordsError:
        """Return the error for a name that is not among ``names``, which have the texts that could be meant."""
        near = difflib.get_close_matches(wanted, names.values(), n=1)
        hint = f", did you mean {near[0]!r}?" if near else ""
        listed = ", ".join(list(names)[:NAMES_SHOWN]) or "none"
        more = f", ... ({len(names)} in all)" if len(names) > NAMES_SHOWN else ""
        return WordsError(f"{wanted!r} is not {what} here{hint}; allowed: {listed}{more}", self.text)

    def _with_lists(self, links: list[_Link], items: Sequence["_Leaf | _Group"]) -> tuple[_Link, ...]:
        """Return the links, where each comma of a list stands for the ``and`` or ``or`` that ends the list."""
        result = list(links)
        for index in reversed(range(len(links))):
            if links[index].operator is not None:
                continue
            end = index + 1 < len(links) and result[index + 1].operator
            if end not in ("and", "or"):
                spoken = ["..." if isinstance(item, _Group) else item.words() for item in items[index : index + 2]]
                readings = [f"{spoken[0]} {operator} {spoken[1]}" for operator in reversed(_OPERATORS)]
                raise WordsError("what does the comma stand for? It could be", self.text, readings)
            result[index] = result[index + 1] = _Link(result[index + 1].operator, loose=False)
        return tuple(result)


def _only_meaning(text: str, group: _Group) -> _Tree:
    """Return the reading of a text all of whose readings are the same task."""
    readings = list(islice(_readings(group.items, group.links), READINGS_TRIED))
    if len(readings) == 1:
        return readings[0]
    meanings: dict[bytes, _Tree] = {}
    for tree in readings:
        letters = sorted({name for leaf in tree.leaves() for name in (leaf.name, leaf.place) if name})
        automaton = build_automaton(_formula(tree, ()), letters)
        meanings.setdefault(automaton.transitions.tobytes() + automaton.accepting.tobytes(), tree)
    if len(meanings) > 1 or len(readings) == READINGS_TRIED:
        shown = [tree.words() for tree in islice(meanings.values(), READINGS_SHOWN)]
        raise WordsError(
            "could mean different things; put brackets, or a comma where it should part. Readings:", text, shown
        )
    return readings[0]


def _readings(
    items: Sequence["_Leaf | _Group"], links: Sequence[_Link], taken: Operator | None = None
) -> Iterator[_Tree]:
    """Yield all ways to bracket the items, except with ``taken`` on top, which the part above already has."""
    if not links:
        (item,) = items
        if isinstance(item, _Leaf):
            yield item
        else:
            yield from _readings(item.items, item.links)
        return
    loose = any(link.loose for link in links)
    for operator in _OPERATORS:
        if operator == taken:
            continue
        places = [i for i, link in enumerate(links) if link.operator == operator and link.loose == loose]
        for count in range(len(places), 0, -1):
            for cuts in combinations(places, count):
                edges = [-1, *cuts, len(links)]
                parts = [list(_readings(items[a + 1 : b + 1], links[a + 1 : b], operator)) for a, b in pairwise(edges)]
                yield from (_Joined(operator, tree) for tree in product(*parts))


def _formula(tree: _Tree, later: tuple[str, ...]) -> str:
    """Return the formula of a tree none of whose interactions may come after one with the objects ``later``."""
    if isinstance(tree, _Leaf):
        name, place = written(tree.name), tree.place and written(tree.place)
        before = " & ".join(f"!{written(one)}" for one in later)
        before = f"({before})" if len(later) > 1 else before

        def eventually(what: str) -> str:
            return f"({before} U {what})" if later else f"F {what}"

        return eventually(f"({name} & X {eventually(place)})") if place else eventually(name)
    if tree.operator == "then":
        parts = []
        for index, part in enumerate(tree.parts):
            after = [leaf.name for stage in tree.parts[index + 1 :] for leaf in stage.leaves()]
            parts.append(_formula(part, (*after, *later)))
        return " & ".join(f"({part})" if " | " in part else part for part in parts)
    parts = [_formula(part, later) for part in tree.parts]
    if tree.operator == "or":
        return " | ".join(
            f"({text})" if isinstance(part, _Joined) else text for part, text in zip(tree.parts, parts, strict=True)
        )
    return " & ".join(f"({part})" if " | " in part else part for part in parts)
