"""Put names and numbers into words: ``RemoteControl``, ``remote_control`` and ``remote control`` are one name."""

import re
import unicodedata

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
