"""`mrtask clean`: it removes nothing before it was told to, and nothing that is in use or that is a result."""

import fcntl
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from mrtask.errors import InputError
from pipeline import clean

OLD = 40 * clean.DAY_S


def made(path: Path, content: str = "x" * 1000) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files and a cache, with something in each."""
    monkeypatch.setenv("MRTASK_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    made(tmp_path / "cache" / "maps" / "one.npz")
    made(tmp_path / "cache" / "locks" / "free")
    made(tmp_path / "tmp" / f"mrtask-mlflow-{os.getuid()}-ab.lock")
    made(tmp_path / "tmp" / "ray" / "session_2026_1" / "logs" / "gcs.out")
    return tmp_path


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    clean.main(arguments)
    return capsys.readouterr().out


def test_it_shows_first_and_then_removes(machine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    others = made(machine / "tmp" / "others.lock")
    before = sorted(machine.rglob("*"))
    shown = said(capsys)
    assert sorted(machine.rglob("*")) == before
    for name in ("cache/maps", "cache/locks/free", "-ab.lock", "ray/session_2026_1"):
        assert f"{name}\n" in shown
    assert "0.0 MB  would go; mrtask clean really=true removes it" in shown
    assert "removed" in said(capsys, "really=true")
    assert [path for path in machine.rglob("*") if path.is_file()] == [others]


def test_what_is_in_use_stays(machine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = machine / "tmp" / "ray" / "session_2026_1"
    held = machine / "cache" / "locks" / "free"
    waits = "import sys; sys.stdin.read()"
    with (
        held.open() as handle,
        subprocess.Popen([sys.executable, "-c", waits, f"--session={session}"], stdin=subprocess.PIPE) as raylet,
    ):
        fcntl.flock(handle, fcntl.LOCK_EX)
        said(capsys, "really=true")
        assert session.is_dir() and held.is_file() and not (machine / "cache" / "maps").exists()
        raylet.communicate()
    said(capsys, "really=true")
    assert not session.exists() and not held.exists()


def test_runs_go_only_where_they_are_asked_for_and_old(machine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = (made(machine / "outputs" / name / "run.json").parent for name in ("old", "new"))
    unsent = made(machine / "datasets" / "unsent" / "ab" / "part-1.parquet")
    for path in (old, *old.iterdir()):
        os.utime(path, (path.stat().st_atime, path.stat().st_mtime - OLD))
    assert "outputs" not in said(capsys, "really=true")
    assert f"outputs/{old.name}\n" in said(capsys, f"runs={machine}/outputs") and old.is_dir()
    said(capsys, f"runs={machine}/outputs", "really=true")
    assert not old.exists() and new.is_dir() and unsent.is_file()
    assert f"outputs/{new.name}\n" in said(capsys, f"runs={machine}/outputs", "days=0")


@pytest.mark.parametrize(
    ("argument", "message"),
    [("realy=true", "realy: no such key"), ("days=-1", "days=-1"), ("runs=nowhere", "nowhere: no such folder")],
)
def test_mistakes_remove_nothing(machine: Path, argument: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        clean.main(["really=true", argument])
    assert (machine / "cache" / "maps").is_dir()
