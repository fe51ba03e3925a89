"""The base class of all mistakes that a user can correct, and the exit codes that all commands share."""

import re
import sys

_USERINFO = re.compile(r"(?<=://)[^\s/:@'\"]*(?::[^\s'\"]*)?@")
_QUERY = re.compile(
    r"([?&;][\w.-]*(?:pass|pwd|secret|token|key|credential|signature|sig)[\w.-]*=)[^&;\s'\")]+", re.IGNORECASE
)

USER_ERROR_EXIT = 2
INTERRUPT_EXIT = 130


class InputError(ValueError):
    """A wrong file, name, formula, option or machine.

    The message says what is wrong, what is allowed and what to change. A program shows it without a traceback; every
    other exception is a bug. As text it has no secrets of addresses.
    """

    def __str__(self) -> str:
        return without_secrets(super().__str__())


def without_secrets(text: str) -> str:
    """Return a text without the secrets of the addresses in it: user and password, and what a query calls a secret.

    Whatever stores or prints an address that a user gave goes through this: ``postgresql://***@host/db?password=***``.
    """
    return _QUERY.sub(r"\1***", _USERINFO.sub("***@", text))


def refuse(mistake: object) -> int:
    """Print a user's mistake and return the exit code for it."""
    print(without_secrets(f"error: {mistake}"), file=sys.stderr)
    return USER_ERROR_EXIT
