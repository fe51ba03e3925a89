import base64
import gzip
import html
import json
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from markupsafe import Markup

from mrtask import files
from mrtask.analysis.drawing.floor_plans import passages, ways_out
from mrtask.analysis.page import exhibits
from mrtask.analysis.page.exhibits import Content
from mrtask.analysis.report import report_page as library
from mrtask.analysis.report import sections
from mrtask.analysis.report.report_page import render_report, trials_to_draw, write_report
from mrtask.analysis.report.run_facts import (
    beats_frequency,
    failure_table,
    homes_facts,
    metric_table,
    model_facts,
    run_facts,
)
from mrtask.analysis.report.sections import Section
from mrtask.analysis.report.trial_browser import notable_trials
from mrtask.execution.trace import Leg, Letter, Trace
from tests.analysis.synthetic import fail, make_episodes, rows

VOID_TAGS = {"meta", "img", "br", "link", "input"}
MANIFEST = {
    "experiment": "paper",
    "seed": 7,
    "planners": ["learned_myopic", "pouct"],
    "planner_options": {"pouct": {"samples": 1000, "time_limit_s": None}},
    "config": {"evaluation": {"robots": [1, 2, 3]}},
    "config_hash": "c0ffee",
    "code_version": "v1-2",
    "wall_s": 3725,
    "stages": {"homes": 3.5, "train": 130.0},
    "model": {
        "name": "container-object-likelihood",
        "version": "4",
        "champion": True,
        "metrics": {"log_loss": 0.31, "roc_auc": 0.9, "rows": 1234.0, "ece": float("nan")},
        "frequency_metrics": {"log_loss": 0.35, "roc_auc": 0.88},
    },
    "homes": {"source": "generated", "evaluated": 300, "reachable_share": 0.9971, "skipped": {"no containers": 2}},
    "machine": {"cpus": 2},
    "unknown": object(),
}


class Page(HTMLParser):
    """A page's text, links and tags; raises where tags do not nest."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open, self.text, self.attributes, self.ids, self.tags = [], [], [], set(), set()
        self.feed(source)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        self.ids |= {value for name, value in attrs if name == "id"}
        if tag not in VOID_TAGS:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join("".join(self.text).split())

    @property
    def images(self) -> list[str]:
        return [value for tag, name, value in self.attributes if (tag, name) == ("img", "src")]


def page_of(folder, episodes, manifest=MANIFEST, homes=None) -> Page:
    path = folder / "index.html"
    write_report(render_report(episodes, manifest, homes or {}), path)
    page = Page(path.read_text(encoding="utf-8"))
    for _, name, value in page.attributes:
        if name == "src":
            assert value.startswith("data:image/"), "the page loads a picture from elsewhere"
        elif name == "href":
            beside = not value.startswith("#") and (folder / value).is_file()
            assert value.removeprefix("#") in page.ids or beside or value == "https://arxiv.org/abs/2603.20544"
        assert not name.startswith("on")
    assert not page.tags & {"link", "iframe"}
    return page


def small(planners=("nonlearned_myopic", "learned_myopic", "pouct"), size_classes=("small",), robots=(1,)):
    return make_episodes(4, planners, size_classes, robots)


@pytest.fixture
def blank_pictures(monkeypatch):
    """For tests of the text: figures are made but not drawn, which takes most of a report's time."""
    monkeypatch.setattr(exhibits, "svg_bytes", lambda figure: b"")


def test_whole_report(tmp_path, two_room_home):
    fridge, _, _ = (container.id for container in two_room_home.containers)
    place = (0.4, 0.9)
    legs = (Leg("move", 0, 1, fridge, None, ((2, 1), place)), Leg("search", 1, 1, fridge, None, (place,)))
    trace = Trace((2.0, 1.0), (legs,), (Letter(1, 0, "Mug", fridge),)).to_json()
    episodes = make_episodes(3).assign(home_id=two_room_home.id, trace=trace)
    page = page_of(tmp_path, episodes, homes={two_room_home.id: two_room_home})
    text = page.words
    assert "Does the planner pouct beat the baselines, by how much" in text
    assert re.search(
        r"Yes\. Over 27 paired trials in 1 home, pouct's mean time is \d+\.\d % lower than learned_myopic's", text
    )
    assert "paper 215.22" in text and "paper 37.12 %" in text
    assert len(page.images) == 8 + 3
    assert "None: all 162 episodes were accepted." in text
    for words in ("c0ffee", "v1-2", "1 h 02 min", "homes: 3.5 s, train: 2 min 10 s", "99.71 %", "no containers: 2"):
        assert words in text, words
    assert "pouct: (samples: 1000)" in text and "cpus: 2" in text
    assert "log loss (lower is better)" in text and "does not beat" not in text
    table = pd.read_csv(tmp_path / "table.csv")
    assert len(table) == (9 + 1) * 6 and not table.duplicated(["size_class", "robots", "planner"]).any()
    assert "their ranks are split evenly between both signs (SciPy's zsplit)" in text
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    for name in ("index.html", "table.csv", "methods.tex", "methods.md", "references.bib", "tables/paper.tex"):
        assert name in files, name
    kinds = {folder: {path.suffix for path in (tmp_path / folder).iterdir()} for folder in ("tables", "figures")}
    assert kinds == {"tables": {".tex", ".md"}, "figures": {".svg"}}
    assert len(list((tmp_path / "figures").glob("*.svg"))) == len(page.images)


def test_figures_for_papers_are_drawn_on_request(monkeypatch, blank_pictures):
    monkeypatch.setattr(exhibits, "pdf_bytes", lambda figure: b"%PDF")
    asked, plain = (set(render_report(small(), {}, {}, pdf=pdf).extras) for pdf in (True, False))
    figures = {name.removesuffix(".svg") for name in plain if name.endswith(".svg")}
    assert figures and asked - plain == {f"{name}.pdf" for name in figures}


def test_a_listed_section_is_on_the_page_and_in_the_navigation(tmp_path, monkeypatch, blank_pictures):
    count = Section(
        "count", "How many", "Number of <episodes>", lambda data: Content(Markup(f"<p>{len(data.episodes)} ran</p>"))
    )
    absent = Section("absent", "Nothing", "Nothing to show", lambda data: None)
    monkeypatch.setattr(library, "SECTIONS", [count, absent, *sections.SECTIONS])
    page = page_of(tmp_path, small(["pouct"]))
    assert ("a", "href", "#count") in page.attributes and "count" in page.ids
    assert "Number of <episodes>4 ran" in page.words.replace("> ", ">") and "Nothing" not in page.words
    assert page.words.index("4 ran") < page.words.index("All planners, all episodes")


CASES = {
    "no episodes": make_episodes(1).head(0),
    "one planner": small(["pouct"]),
    "only baselines": small(["nonlearned_myopic", "learned_myopic"]),
    "a user's planner": small(["learned_myopic", "lab.planners.Mine"]),
    "missing cells": pd.concat(
        [small(["learned_myopic", "pouct"], robots=[3]), small(["greedy"], size_classes=["large"])]
    ),
    "none accepted": small().assign(status="failed", error="Mug is nowhere"),
    "a planner failed everywhere": fail(small(), small()["planner"] == "pouct"),
    "a planner failed in one cell": (lambda frame: fail(frame, (frame["planner"] == "pouct") & (frame["robots"] == 2)))(
        small(robots=[1, 2])
    ),
    "a cell of one planner is missing": small(robots=[1, 2]).query("planner != 'pouct' or robots == 1"),
    "a single trial": small().query("trial_id == 'small-1-000'"),
    "a single episode": small(["pouct"]).head(1),
    "planners share no trial": rows("small", 1, {"pouct": [None, 1.0], "learned_myopic": [2.0, None]}),
    "one trial of another size class": small(size_classes=["hall"], robots=[8]).head(3),
    "costs of zero": rows("small", 1, {"pouct": [0.0, 0.0], "learned_myopic": [0.0, 0.0]}),
    "required columns only": small()[["trial_id", "size_class", "robots", "planner", "status", "cost_s", "cost_cells"]],
    "nulls everywhere": small().assign(
        error=None, samples=None, decisions=None, planning_s=None, home_id=None, trace=None
    ),
}


DRAWN = ("missing cells", "a single trial", "nulls everywhere")
"""The cases whose pictures are the oddest."""


@pytest.mark.parametrize("name", CASES)
def test_copes_with_missing_data(tmp_path, name, request):
    if name not in DRAWN:
        request.getfixturevalue("blank_pictures")
    text = page_of(tmp_path, CASES[name], {}).words
    assert "Episodes without a result" in text
    assert not re.search(r"\bnan\b|\bNone\b(?!:)|\binf\b|\[\]|\{\}", text)


def test_failures_are_shown_with_their_reasons(tmp_path, blank_pictures):
    frame = small()
    frame = fail(frame, frame["trial_id"] == "small-1-000", "failed", "Mug is in no reachable container")
    frame = fail(
        frame, frame.index.to_series() == 11, "error", "Traceback (most recent call last):\n  File\nKeyError: 'x'\n"
    )
    text = page_of(tmp_path, frame).words
    assert "Mug is in no reachable container" in text and "KeyError: 'x'" in text and "most recent call" not in text
    assert "1 episode ended with status error (pouct 1)." in text
    assert "2/4 finished" in text


def test_text_is_escaped(tmp_path, blank_pictures):
    evil = '<script>alert("1")</script>&amp;'
    frame = small(["learned_myopic", "pouct"])
    frame = frame.assign(home_id=evil, formula=evil, template=evil, config_hash=evil, sweep=evil)
    frame = fail(frame, frame.index.to_series() == 0, "error", evil)
    manifest = {"experiment": evil, "config": {evil: evil}, "model": {"note": evil}, "homes": {"skipped": {evil: 1}}}
    page = page_of(tmp_path, frame, manifest)
    assert page.words.count(evil) >= 5
    tables = {path.suffix: path.read_text(encoding="utf-8") for path in (tmp_path / "tables").glob("failures.*")}
    assert r"$<$script$>$alert" in tables[".tex"] and r"\<script\>alert" in tables[".md"]
    assert html.escape(evil, quote=False) in (tmp_path / "index.html").read_text(encoding="utf-8").replace("&#34;", '"')


def test_sweep_is_compared(tmp_path, blank_pictures):
    parts = []
    for samples, factor in ((100, 1.2), (1000, 1.0)):
        for robots in (1, 2):
            frame = small(robots=[robots])
            frame.loc[frame["planner"] == "pouct", "cost_s"] *= factor
            parts.append(frame.assign(sweep=f"planner.pouct.samples={samples},evaluation.robots=[{robots}]"))
    page = page_of(tmp_path, pd.concat(parts[::-1]))
    assert "The sweep has 2 variants" in page.words and "those of the last, planner.pouct.samples=1000" in page.words
    assert "variants" in page.ids
    table = pd.read_csv(tmp_path / "table.csv")
    assert list(table["sweep"].unique()) == ["planner.pouct.samples=100", "planner.pouct.samples=1000"]
    pouct = table[table["planner"] == "pouct"].groupby("sweep")["mean_cost_s"].sum()
    assert pouct.iloc[0] == pytest.approx(1.2 * pouct.iloc[1], rel=1e-5)


def test_the_models_that_one_command_trained_stand_side_by_side():
    metrics = [{"log_loss": loss, "roc_auc": 0.9, "ece": 0.01} for loss in (0.08, 0.09, 0.1)]
    manifest = {
        "model": {
            "kind": "similarity", "version": "2", "metrics": metrics[0], "frequency_metrics": metrics[2],
            "champion_version": "1",
        },
        "rivals": [{"kind": "paper_fcnn", "version": "3", "metrics": metrics[1]}],
    }  # fmt: skip
    table = metric_table(manifest)
    assert [name for _, name in table.columns] == ["this model, similarity", "paper_fcnn, version 3", "frequency table"]
    assert [entry.value for entry in table.rows[0].entries] == ["0.0800", "0.0900", "0.1000"]
    assert [row.label.partition(" (")[0] for row in table.rows] == ["log loss", "ROC AUC", "expected calibration error"]
    champion = dict(model_facts(manifest, small().head(1)))["champion"]
    assert champion == "no, the champion was version 1; this run did not plan with it"


@pytest.mark.parametrize(
    ("model", "beats"),
    [
        ({"metrics": {"log_loss": 0.3}, "frequency_metrics": {"log_loss": 0.4}}, True),
        ({"metrics": {"log_loss": 0.4}, "frequency_metrics": {"log_loss": 0.4}}, False),
        ({"metrics": {"roc_auc": 0.8}, "frequency_metrics": {"roc_auc": 0.9}}, False),
        ({"beats_frequency": False, "metrics": {"log_loss": 0.3}, "frequency_metrics": {"log_loss": 0.4}}, False),
        ({"metrics": {"log_loss": 0.3}}, None),
        ({"metrics": {"log_loss": float("nan")}, "frequency_metrics": {"log_loss": 0.4}}, None),
        ({}, None),
    ],
)
def test_warns_of_a_model_that_is_no_better_than_counting(tmp_path, model, beats, blank_pictures):
    assert beats_frequency({"model": model}) is beats
    text = page_of(tmp_path, small(["pouct"]).head(1), {"model": model}).words
    assert ("The likelihood model does not beat the frequency table on held-back homes" in text) == (beats is False)


def test_missing_episodes_are_named(tmp_path, blank_pictures):
    text = page_of(tmp_path, small(["pouct"]), {"expected_episodes": 10}).words
    assert "6 of 10 episodes are missing: the evaluation has not finished." in text


def test_refuses_before_it_writes(tmp_path):
    folder = tmp_path / "report"
    with pytest.raises(ValueError, match="unknown episode status"):
        page_of(folder, small().assign(status="ok"))
    assert not folder.exists()


def test_a_report_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch, blank_pictures):
    write_report(render_report(small(["pouct"]), {}, {}), tmp_path / "index.html")
    before = (tmp_path / "index.html").read_bytes()
    monkeypatch.setattr(files.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_report(render_report(small(["greedy"]), {}, {}), tmp_path / "index.html")
    assert (tmp_path / "index.html").read_bytes() == before
    assert not list(tmp_path.rglob(".*")), "nothing half-written is left"


def test_no_absolute_path_is_in_the_report(tmp_path, monkeypatch, blank_pictures):
    monkeypatch.chdir(tmp_path)
    manifest = {
        "output_dir": f"{tmp_path}/outputs/x",
        "command": "python -m pipeline.report output_dir=/home/jane/x",
        "homes": {"files": ["/home/jane/data/homes.jsonl.gz"], "source": "https://example.org/a/b"},
        "config": {"tracking": {"uri": "sqlite:////home/jane/mlflow.db"}, "cache_dir": "~/.cache/mrtask"},
    }
    frame = fail(small(["pouct"]), pd.Series([True, False, False, False]), "error", "no file '/home/jane/data/model'")
    page = page_of(tmp_path, frame, manifest)
    source = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "jane" not in source and str(tmp_path) not in source
    for words in ("output_dir=outputs/x", ".../homes.jsonl.gz", "no file '.../model'", "sqlite:///.../mlflow.db"):
        assert words in page.words, words
    assert "https://example.org/a/b" in page.words and "~/.cache/mrtask" in page.words


def test_same_input_same_bytes(tmp_path):
    frame = small(["learned_myopic", "pouct"])
    for name, rows_ in (("a", frame), ("b", frame.sample(frac=1, random_state=0))):
        write_report(render_report(rows_, MANIFEST | {"unknown": 1}, {}), tmp_path / name / "index.html")
    assert (tmp_path / "a/index.html").read_bytes() == (tmp_path / "b/index.html").read_bytes()
    assert (tmp_path / "a/table.csv").read_bytes() == (tmp_path / "b/table.csv").read_bytes()


def test_many_episodes_stay_small(tmp_path):
    write_report(render_report(make_episodes(200, ["learned_myopic", "pouct"]), {}, {}), tmp_path / "index.html")
    assert (tmp_path / "index.html").stat().st_size < 3_000_000


def test_trials_to_draw_are_those_drawn(two_room_home, tmp_path, blank_pictures):
    trace = Trace((2.0, 1.0), ((),), ()).to_json()
    frame = small(["learned_myopic", "pouct"]).assign(trace=trace)
    frame["home_id"] = np.where(frame["trial_id"] == "small-1-003", two_room_home.id, frame["home_id"])
    picks = trials_to_draw(frame.drop(columns="trace"), {})
    assert picks.trial_ids == set(frame["trial_id"]) and picks.home_ids == set(frame["home_id"])
    assert picks.planners == ("pouct", "learned_myopic")
    page = page_of(tmp_path, frame, {}, dict.fromkeys(picks.home_ids, two_room_home))
    assert "Most saved" in page.words and two_room_home.id in page.words
    assert trials_to_draw(frame.head(0), {}).trial_ids == frozenset()


def test_every_trial_can_be_looked_up(tmp_path, two_room_home, blank_pictures):
    trace = Trace((2.0, 1.0), ((Leg("move", 0, 1, None, None, ((2, 1), (1, 1))),),), ()).to_json()
    frame = small(["learned_myopic", "pouct"]).assign(trace=trace, home_id=two_room_home.id)
    frame = fail(frame, (frame["trial_id"] == "small-1-001") & (frame["planner"] == "pouct"))
    page_of(tmp_path, frame, {"output_dir": "outputs/x"}, {two_room_home.id: two_room_home})
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    packed = re.search(r'id="trials-data"[^>]*>([^<]*)<', text)[1]
    data = json.loads(gzip.decompress(base64.b64decode(packed)))
    by_key = frame.set_index(["trial_id", "planner"])
    assert data["names"] == ["learned_myopic", "pouct"], "in the order of the tables"
    assert data["compared"] == [1, 0], "the planner, then the baseline"
    [home] = data["homes"]
    assert len(home["doors"]) == len(passages(two_room_home)) > 0
    assert len(home["ways_out"]) == len(ways_out(two_room_home))
    for trial in data["trials"]:
        assert trial["task"] == "Mug and Book" and trial["robots"] == 1
        for name, cost, status in zip(data["names"], trial["cost"], trial["status"], strict=True):
            row = by_key.loc[(trial["id"], name)]
            assert status == row["status"]
            assert cost is None if status == "failed" else cost == pytest.approx(row["cost_cells"], abs=0.05)
        assert trial["paths"]["0"] == [[230, 330, 130, 330]], "centimetres from the top left corner, 30 cm of margin"
    assert text.count("<circle") == 3, "one point for each trial that both finished"
    assert {path.stem for path in (tmp_path / "replays").iterdir()} == {trial["id"] for trial in data["trials"]}
    assert "small-1-001" in text and ">failed<" in text


def test_a_row_that_cannot_be_replayed_is_named_and_the_others_are_replayed(tmp_path, two_room_home, blank_pictures):
    trace = Trace((2.0, 1.0), ((Leg("move", 0, 1, None, None, ((2, 1), (1, 1))),),), ()).to_json()
    frame = small(["learned_myopic", "pouct"]).assign(trace=trace, home_id=two_room_home.id)
    frame.loc[frame["trial_id"] == "small-1-002", "formula"] = "F (Mug"
    page = page_of(tmp_path, frame, {}, {two_room_home.id: two_room_home})
    assert "Trial small-1-002 cannot be replayed" in page.words and "this '(' is never closed" in page.words
    notable = {pick.trial_id for pick in notable_trials(frame, "pouct")}
    assert "small-1-002" in notable
    assert {path.stem for path in (tmp_path / "replays").iterdir()} == notable - {"small-1-002"}


def test_the_notable_trials_by_hand():
    costs = {"pouct": [5.0, 9.0, None, 4.0], "learned_myopic": [6.0, 7.0, 7.0, 4.0]}
    frame = rows("small", 1, costs).assign(home_id="h")
    assert [(pick.trial_id[-1], pick.reason) for pick in notable_trials(frame, "pouct")] == [
        ("0", "most saved"),
        ("3", "median saved"),
        ("1", "most lost"),
        ("2", "failed"),
    ]
    worse = rows("small", 1, {"pouct": [float(n + 20) for n in range(20)], "learned_myopic": [10.0] * 20})
    found = [pick.reason for pick in notable_trials(worse.assign(home_id="h"), "pouct")]
    assert len(found) == 3 + 9 and found[-1] == "lost 20.0 s", "the worst of ten is among the representative"
    assert notable_trials(frame, None) == []


def test_facts_from_rows_where_the_manifest_has_none():
    frame = small(["pouct"]).assign(config_hash="abc", code_version="v9")
    assert ("configuration", "abc") in run_facts({}, frame) and ("code version", "v9") in run_facts({}, frame)
    assert homes_facts({}, frame) == (("in the episodes", "4"),)


def test_many_reasons_are_cut():
    frame = make_episodes(60, ["pouct"], ["small"], [1])
    frame = frame.assign(status="failed", error=[f"reason {number:02d} {'x' * 300}" for number in range(60)])
    table = failure_table(frame)
    assert len(table.rows) == 26 and table.rows[-1].label == "35 other reasons"
    assert all(len(row.label) <= 240 for row in table.rows)


def test_manifest_survives_json():
    manifest = json.loads(json.dumps({key: value for key, value in MANIFEST.items() if key != "unknown"}))
    assert run_facts(manifest, small(["pouct"])) == run_facts(MANIFEST, small(["pouct"]))
