"""Ctrl-C that is not lost: Python drops a `KeyboardInterrupt` raised inside a finalizer or a weak reference's callback.

The handler raises as usual and also remembers; long loops call `check`, so that a dropped interrupt stops them still.
While a stage's libraries are imported, which takes seconds, an interrupt just ends the process.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from mrtask.errors import INTERRUPT_EXIT

MESSAGE = "\ninterrupted; the same command continues from here"

_requested = False


def ends_imports() -> None:
    """From now on an interrupt ends the process with one line; nothing is under way yet that needs tidying up."""
    signal.signal(signal.SIGINT, _leave)


@contextmanager
def remembered() -> Iterator[None]:
    """Within, an interrupt is remembered for `check`."""
    global _requested
    _requested = False
    before = signal.signal(signal.SIGINT, _handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def check() -> None:
    """Raises `KeyboardInterrupt` if there was one."""
    if requested():
        raise KeyboardInterrupt


def requested() -> bool:
    """Whether there was one."""
    return _requested


def _handle(number: int, frame: FrameType | None) -> None:
    global _requested
    _requested = True
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    print(MESSAGE, file=sys.stderr, flush=True)
    os._exit(INTERRUPT_EXIT)
