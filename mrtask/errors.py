"""The base class of all mistakes that a user can correct, and the exit codes that all commands share."""

import sys

USER_ERROR_EXIT = 2
INTERRUPT_EXIT = 130


class InputError(ValueError):
    """A wrong file, name, formula, option or machine.

    The message says what is wrong, what is allowed and what to change. A program shows it without a traceback; every
    other exception is a bug.
    """


def refuse(mistake: object) -> int:
    """Print a user's mistake and return the exit code for it."""
    print(f"error: {mistake}", file=sys.stderr)
    return USER_ERROR_EXIT
