"""Keeps Ctrl-C from being lost: Python drops a `KeyboardInterrupt` in a finalizer or a weak reference's callback.

SIGTERM, with which schedulers end a job (scancel, an eviction, a spot machine), does the same as Ctrl-C.
The handler raises as usual and also remembers; long loops call `check`, so that a dropped interrupt stops them too.
While a stage imports its libraries, which takes seconds, an interrupt just ends the process.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from mrtask.errors import INTERRUPT_EXIT

MESSAGE = "\ninterrupted; the same command continues from here"

SIGNALS = (signal.SIGINT, signal.SIGTERM)

_requested = False


def ends_imports() -> None:
    """Let an interrupt end the process with one line from now on; nothing needs tidying up yet."""
    signal.signal(signal.SIGINT, _leave)


@contextmanager
def remembered() -> Iterator[None]:
    """Remember an interrupt for `check` while the context runs."""
    global _requested
    _requested = False
    before = {number: signal.signal(number, _handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _requested = False


def rearm() -> None:
    """Handle SIGTERM again, if interrupts are remembered, after something else has taken it over."""
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is _handle:
        signal.signal(signal.SIGTERM, _handle)


@contextmanager
def importing() -> Iterator[None]:
    """Let an interrupt end the process with one line while the context runs: half an import cannot be undone."""
    before = signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def check() -> None:
    """Raise `KeyboardInterrupt` if there was an interrupt."""
    if requested():
        raise KeyboardInterrupt


def requested() -> bool:
    """Tell whether there was an interrupt."""
    return _requested


def _handle(number: int, frame: FrameType | None) -> None:
    global _requested
    if number == signal.SIGTERM and _requested:  # schedulers send several; the first must be able to tidy up
        return
    _requested = True
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    print(MESSAGE, file=sys.stderr, flush=True)
    os._exit(INTERRUPT_EXIT)
