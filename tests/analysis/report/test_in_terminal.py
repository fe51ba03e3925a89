"""The few lines that a run ends with in a terminal."""

import pandas as pd

from mrtask.analysis.report.in_terminal import never_succeeded, result_lines
from tests.analysis.synthetic import rows


def lines_of(frame: pd.DataFrame) -> list[str]:
    return [" ".join(line.replace("\N{NO-BREAK SPACE}", " ").split()) for line in result_lines(frame)]


def test_each_planner_has_a_line_and_the_headline_what_it_hides():
    costs = {"nonlearned_myopic": [20.0] * 12, "learned_myopic": [10.0] * 12, "pouct": [5.0] * 6 + [10.0] * 6}
    lines = lines_of(rows("small", 1, costs))
    assert lines[:3] == [
        "accepted mean (s) saves of nonlearned_myopic (%) saves of learned_myopic (%)",
        "nonlearned_myopic 12/12 20.00 \N{EN DASH} -100.0 [-100.0, -100.0]",
        "learned_myopic 12/12 10.00 50.0 [50.0, 50.0] \N{EN DASH}",
    ]
    assert lines[3].startswith("pouct 12/12 7.50 62.5 [")
    assert lines[4].startswith("Over 12 paired trials, pouct's mean time is 25.0 % lower than learned_myopic's (95 %")
    assert lines[5] == (
        "Trial by trial against learned_myopic: the median saving is 25.0 %, 50 % are ties, and in 0 % it is later."
    )
    assert len(lines) == 7, "nothing failed"


def test_what_failed_is_one_line_with_the_commonest_reasons():
    frame = rows("small", 1, {"pouct": [1.0, None, None, None, None], "mine.Own": [None] * 5})
    lost = frame["status"] != "accepted"
    frame.loc[lost, "error"] = (
        ["in no container: Mug"] * 2 + ["in no container: Pen"] + ["Traceback\n\nKeyError: 3"] * 6
    )
    frame.loc[frame.index[-1], "status"] = "timeout"
    frame.loc[frame.index[-6:-1], "status"] = "error"
    assert lines_of(frame)[-1] == (
        "9 of 10 episodes without a result: 5 error (mostly: KeyError: 3); 3 failed (mostly: in no container: Mug); "
        "1 timeout (mostly: KeyError: 3)"
    )
    assert never_succeeded(frame) == {"mine.Own": 5}


def test_a_sweeps_variants_each_have_a_table():
    frame = pd.concat([rows("small", 1, {"pouct": [cost]}).assign(sweep=f"seed={cost}") for cost in (1.0, 2.0)])
    lines = lines_of(frame)
    assert lines[0] == "seed=1.0" and lines[2] == "pouct 1/1 1.00"
    assert lines[3] == "seed=2.0" and lines[5] == "pouct 1/1 2.00"
