"""The reliability diagram shows its bins, and the page the diagram."""

import pytest

from mrtask.analysis.report.reliability import draw_reliability
from mrtask.analysis.report.report_page import render_report
from mrtask.analysis.studies.calibration import ALL_OBJECTS, EXISTING
from tests.analysis.synthetic import make_episodes

BINS = [
    {"belief": ALL_OBJECTS, "mean_prob": 0.02, "frequency": 0.03, "low": 0.02, "high": 0.05, "pairs": 900},
    {"belief": EXISTING, "mean_prob": 0.65, "frequency": 0.54, "low": 0.5, "high": 0.6, "pairs": 80},
    {"belief": EXISTING, "mean_prob": 0.84, "frequency": 0.69, "low": None, "high": None, "pairs": 3},
]


def test_every_bin_is_drawn_with_its_interval():
    plain, there = draw_reliability(BINS).axes
    assert plain.containers[0].lines[0].get_xydata().tolist() == [[0.02, 0.03]]
    assert there.containers[0].lines[0].get_xydata().tolist() == [[0.65, 0.54], [0.84, 0.69]]
    bars = [segment[:, 1].tolist() for segment in there.containers[0].lines[2][0].get_segments()]
    assert bars == [pytest.approx([0.5, 0.6]), pytest.approx([0.69, 0.69])]
    assert draw_reliability([]) is None


def test_the_page_shows_the_diagram_where_the_run_has_one():
    frame = make_episodes(2, ["pouct"])
    title = "How often objects were where the model said"
    assert title in render_report(frame, {"reliability": BINS}, {}).page
    assert title not in render_report(frame, {}, {}).page
