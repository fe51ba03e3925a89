"""An interrupt that Python drops stops the next loop all the same."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from pipeline.backends.pool import Pool
from pipeline.base import interrupt
from pipeline.base.sections import Cluster
from tests.pipeline import pool_tasks as tasks


class Finalized:
    """Gets its interrupt where Python cannot raise it."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_dropped_interrupt_is_raised_at_the_next_check(ray_session: None) -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupt.remembered():
        interrupt.check()
        Finalized()
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
        cluster = Cluster(address="local", cpus=2, memory_per_task_gb=0.5, retries=0)
        with Pool(cluster) as pool, pytest.raises(KeyboardInterrupt):
            list(pool.run(tasks.square, range(3)))
    with interrupt.remembered():
        interrupt.check()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_schedulers_signal_is_an_interrupt_and_a_second_one_lets_the_first_tidy_up() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with interrupt.remembered():
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # as Ray takes it over
        interrupt.rearm()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
        assert interrupt.requested()
    assert not interrupt.requested()
    assert signal.getsignal(signal.SIGTERM) is before


def test_an_interrupt_while_libraries_are_imported_is_one_line() -> None:
    command = [sys.executable, "-m", "pipeline.evaluate", "--help"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # One of the first of the libraries; the heavy ones follow.
    while not any("pydantic_core" in one.path for one in psutil.Process(process.pid).memory_maps()):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "\ninterrupted; the same command continues from here\n")
