"""The one base of all mistakes that a user can correct: a wrong file, name, formula, option or machine."""


class InputError(ValueError):
    """A mistake in what was given. The message says what is wrong, what is allowed and what to change.

    A program shows it without a traceback; every other exception is a bug.
    """
