"""Ctrl-C that is not lost: Python drops a `KeyboardInterrupt` raised inside a finalizer or a weak reference's callback.

The handler raises as usual and also remembers; long loops call `check`, so that a dropped interrupt stops them still.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_requested = False


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
    if _requested:
        raise KeyboardInterrupt


def _handle(number: int, frame: FrameType | None) -> None:
    global _requested
    _requested = True
    raise KeyboardInterrupt
