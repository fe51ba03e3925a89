import re
from pathlib import Path

import yaml

from mrtask.analysis.report.methods import bibtex, methods_latex, methods_markdown, methods_sentences
from mrtask.analysis.report.report_data import collect_report_data
from mrtask.analysis.results.published import load_published
from tests.analysis.synthetic import fail, make_episodes

CITATION = yaml.safe_load((Path(__file__).parents[3] / "CITATION.cff").read_text())
MANIFEST = {
    "seed": 7,
    "planner_options": {"pouct": {"samples": 10000}, "greedy": {"reassign": "all"}},
    "config": {"evaluation": {"speed_m_per_s": 1.0, "search_time_s": 0.5, "interact_time_s": 0}},
    "code_version": "abc_1",
    "homes": {"source": "procthor"},
    "model": {"kind": "similarity", "version": "3", "training_homes": 500},
    "machine": {"cpus": 96, "platform": "Linux-6.1", "python": "3.11.7", "memory_gb": 512.0},
    "packages": {"numpy": "2.4.6", "torch": "2.13.0"},
    "wall_s": 12345.6,
    "output_dir": "/home/somebody/outputs/x",
}


def fields(entry: str) -> dict[str, str]:
    return dict(re.findall(r"^  (\w+) = \{+(.*?)\}+,$", entry, re.MULTILINE))


def test_citations_are_those_of_the_citation_file():
    paper, software = bibtex(load_published(), "abc_1").split("\n\n")
    reference = CITATION["references"][0]
    names = [f"{author['family-names']}, {author['given-names']}" for author in reference["authors"]]
    assert paper.startswith("@inproceedings{") and fields(paper) == {
        "author": " and ".join(names),
        "title": reference["title"],
        "booktitle": reference["collection-title"],
        "year": str(reference["year"]),
        "eprint": reference["identifiers"][0]["value"].removeprefix("arXiv:"),
        "archivePrefix": "arXiv",
    }
    assert software.startswith("@software{") and fields(software) == {
        "author": CITATION["authors"][0]["name"],
        "title": CITATION["title"],
        "version": CITATION["version"],
        "year": CITATION["date-released"][:4],
        "note": r"code abc\_1",
    }
    assert "note" not in bibtex(load_published(), None)


def test_machines_are_counted_but_not_named():
    frame = make_episodes(2, ["greedy", "pouct"], ["small"], [1]).assign(node="lab1", attempt=1)
    one = " ".join(methods_sentences(collect_report_data(frame, MANIFEST, {})))
    assert "machines" not in one and "more than once" not in one
    frame.loc[0, ["node", "attempt"]] = ["lab2", 2]
    two = " ".join(methods_sentences(collect_report_data(frame, MANIFEST, {})))
    assert "The episodes ran on 2 machines. 1 episode was sent to a worker more than once" in two
    assert "lab" not in two.replace("available", "")


def test_the_paragraph_has_the_runs_numbers():
    frame = make_episodes(4, ["greedy", "pouct"], ["small", "large"], [1, 3])
    frame = fail(frame, frame.index.to_series() == 0)
    sentences = methods_sentences(collect_report_data(frame, MANIFEST, {}))
    assert sentences[0] == (
        "We ran 16 trials, 4 for each of 4 cells of home size (small and large) and team size (1 and 3), in 16 homes "
        "(procthor)."
    )
    text = " ".join(sentences)
    for words in (
        "of the form and2.",
        "1 m/s; a search takes 0.5 s and an interaction 0 s",
        "greedy and pouct (at most 10,000 samples)",
        "of kind similarity, version 3, trained on 500 other homes",
        "Of 32 episodes 31 finished",
        "The seed is 7;",
        "(code abc_1), Python 3.11.7, numpy 2.4.6 and torch 2.13.0.",
    ):
        assert words in text, words
    for of_the_machine in ("Linux", "96", "512", "12345", "/home"):
        assert of_the_machine not in text
    assert r"abc\_1" in methods_latex(sentences) and r"\cite{khanal2026multirobot,mrtask}" in methods_latex(sentences)
    assert r"abc\_1" in methods_markdown(sentences)


def test_what_was_not_recorded_is_left_out():
    text = " ".join(methods_sentences(collect_report_data(make_episodes(2, ["pouct"], ["small"], [1]), {}, {})))
    assert "We ran 2 trials, 2 for each of 1 cell" in text and "None" not in text and "The software is mrtask" in text
    assert methods_sentences(collect_report_data(make_episodes(1).head(0), {}, {}))[0] == "No episode was run."
