"""What a stage says while it works."""

import pytest

from pipeline.base import console


class Clock:
    """A clock that advances on demand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr("pipeline.base.console.time.monotonic", lambda: self.now_s)


def test_time_left_does_not_count_what_passed_before_the_first_result(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock(monkeypatch)
    with console.Progress(100, "homes", done=40) as progress:
        clock.now_s += 60.0  # workers start
        progress.update()
        clock.now_s += 20.0
        progress.update(10, "all well")
        clock.now_s += 1.0
        progress.update()  # too soon after the last line
    said = capsys.readouterr().out.splitlines()
    # Ten in the 20 s since the first: 0.5 a second for the remaining 49.
    assert said == ["   41/100 homes", "   51/100 homes, 0.5/s, 1 min 38 s left, all well"]
