"""Put names and numbers into words: ``RemoteControl``, ``remote_control`` and ``remote control`` are one name."""

import difflib
import re
import unicodedata
from collections.abc import Iterable

from mrtask.errors import InputError

_WORD_BOUNDARY = re.compile(r"(?<=[^\W_A-Z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][^\W\d_A-Z])")
_SEPARATORS = re.compile(r"[\s_\-]+")
_UNFIT = re.compile(r'["\x00-\x1f\x7f-\x9f\ud800-\udfff]')


def check_name(name: str) -> str:
    """Return the name of an object or a container.

    Raises:
        InputError: the name is empty, or it has a double quote or a control character, which nothing can quote.
    """
    if not name.strip():
        raise InputError("a name cannot be empty")
    if unfit := _UNFIT.search(name):
        raise InputError(f"the name {name!r} holds {unfit[0]!r}; names have no double quotes and control characters")
    return name


def name_to_text(name: str) -> str:
    """Return the words of a name: ``RemoteControl`` -> ``remote control``, ``TVStand`` -> ``tv stand``.

    Every string is allowed: lone surrogates become ``?``, other scripts stay, and an empty name stays empty.
    """
    if not isinstance(name, str):
        raise TypeError(f"a name must be a string, got {name!r} of type {type(name).__name__}")
    clean = unicodedata.normalize("NFKC", name.encode("utf-8", "replace").decode("utf-8"))
    return _SEPARATORS.sub(" ", _WORD_BOUNDARY.sub(" ", clean)).strip().lower()


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 robot``, ``2 robots``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(names: Iterable[str]) -> str:
    """Return at least one name in a row: ``a, b and c``."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def suggest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint for a wrong word: the nearest allowed one, if one is near, and all that are allowed."""
    words = list(allowed)
    return f"{did_you_mean(word, words)}allowed: {', '.join(words)}"


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """Return a question that names the nearest allowed word, with a space at its end, or nothing if none is near."""
    near = difflib.get_close_matches(word, list(allowed), n=1)
    return f"did you mean {near[0]}? " if near else ""
