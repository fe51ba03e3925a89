"""Tasks that workers of the pool tests run; in a module, because workers import what they run."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from pipeline.store.worker import generate_numbered


def square(item: int) -> int:
    """The square."""
    return item * item


def fail_until(item: int, folder: Path, failures: int) -> int:
    """Raises the first ``failures`` times that it is asked for an item."""
    if _count(folder, item) <= failures:
        raise ValueError(f"item {item} is not to my liking")
    return item


def die_until(item: int, folder: Path, deaths: int) -> int:
    """Kills its process the first ``deaths`` times that it is asked for an odd item."""
    if item % 2 and _count(folder, item) <= deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def sleep(seconds: float) -> float:
    """Takes that long."""
    time.sleep(seconds)
    return seconds


def sleep_deaf(seconds: float) -> float:
    """Takes that long, whatever signals say."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    time.sleep(seconds)
    return seconds


def span(item: int, seconds: float) -> tuple[float, float]:
    """When it began and ended, having slept in between."""
    began_s = time.monotonic()
    time.sleep(seconds)
    return began_s, time.monotonic()


def worst_of_many(item: int, folder: Path) -> int:
    """Nothing, but item 30 kills its first worker, 31 raises once, and 32 never ends."""
    if item == 32:
        return int(sleep(60.0))
    if item == 30:
        return die_until(2 * item + 1, folder, 1) // 2
    return fail_until(item, folder, 1) if item == 31 else item


def identity_of_shared(item: int, shared: np.ndarray) -> tuple[int, int]:
    """Process and address of a shared value."""
    return os.getpid(), id(shared)


def house_rooms(item: int, seed: int) -> list[str]:
    """The rooms of a generated house: something with randomness."""
    return [room["roomType"] for room in generate_numbered(item, seed)["rooms"]]


def _count(folder: Path, item: int) -> int:
    with (folder / str(item)).open("a") as file:
        file.write("x")
        return file.tell()
