"""Stores that cannot be used: told in one line, soon, and before a stage makes anything."""

import socket
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.backends import addresses, runs
from tests.pipeline.harness import Cli

CASES = Path(__file__).resolve().parents[4] / "shared" / "cases" / "mlflow-store-errors"


@pytest.fixture
def silent() -> Iterator[str]:
    """The address of a server that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def nobody() -> str:
    """A port at which nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"127.0.0.1:{server.getsockname()[1]}"


def refusal(uri: str) -> str:
    """What opening a store says, in one line."""
    with pytest.raises(runs.TrackingError, match=r"tracking\.uri=.*: MLflow's store cannot be opened") as refused:
        runs.open_tracking(uri, "mrtask")
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("scheme", ["http://{}", "https://{}/mlflow", "postgresql+psycopg2://me:secret@{}/runs"])
def test_nobody_listens(nobody: str, scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(addresses, "_check_driver", lambda uri: None)
    said = refusal(scheme.format(nobody))
    assert f"nobody answers at {nobody}" in said and "secret" not in said


def test_a_server_that_never_answers(silent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "FIRST_CONNECTION_S", 1)
    assert "timed out" in refusal(silent).lower()


def test_a_line_says_what_is_waited_for(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    tried: list[float] = []

    def connect(address: tuple[str, int], timeout_s: float) -> None:
        tried.append(timeout_s)
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", connect)
    assert "nobody answers at far.example:5000 (timed out)" in refusal("http://far.example:5000")
    assert tried == [addresses.SILENT_S, addresses.FIRST_CONNECTION_S]
    assert "waiting for far.example:5000 at most 20 s" in capsys.readouterr().out


def test_each_server_has_a_lock_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that does not answer holds nobody up who uses another."""
    monkeypatch.setattr(runs, "check_usable", lambda uri: None)
    found = runs.Experiment("1", "mrtask", "s3://there", "active", tags=[])
    monkeypatch.setattr(runs, "_experiment", lambda *arguments: found)
    one, same, other = (
        runs.open_tracking(uri, "mrtask").lock_path for uri in ("http://a:1", "http://a:1", "http://b:1")
    )
    assert one == same != other


def test_databases_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(addresses, "SILENT_S", 0.0)
    monkeypatch.setattr(addresses, "FIRST_CONNECTION_S", 0.0)
    (tmp_path / "bad.db").write_text("this is no database, however long one reads on in it\n" * 30)
    locked = tmp_path / "locked.db"
    holder = sqlite3.connect(locked, isolation_level=None)
    holder.execute("CREATE TABLE t (x)")
    holder.execute("BEGIN EXCLUSIVE")
    assert "bad.db: file is not a database" in refusal(f"sqlite:///{tmp_path}/bad.db")
    assert "locked.db: database is locked" in refusal(f"sqlite:///{locked}")
    assert "is a folder; give a file in it" in refusal(f"sqlite:///{tmp_path}")
    assert "write sqlite:///FILE" in refusal("sqlite:/one-slash.db")
    holder.close()


def test_a_database_whose_driver_is_missing() -> None:
    said = refusal("mysql+nosuchdriver://me:secret@127.0.0.1:1/runs")
    assert "nosuchdriver" in said and "secret" not in said
    said = refusal("mysql+mysqldb://me:secret@127.0.0.1:1/runs")
    assert "the database's driver is not installed (No module named 'MySQLdb')" in said


@pytest.mark.parametrize("stage", ["train", "evaluate", "reproduce", "report", "optimality", "ablation", "priors"])
def test_stages_open_the_store_before_they_make_anything(stage: str, cli: Cli, tmp_path: Path) -> None:
    done = cli(stage, "experiment=smoke", "model=frequency", "tracking.uri=sqlite:/one-slash.db")
    assert done.code == 2 and done.err.count("\n") == 1, done.err
    assert "write sqlite:///FILE" in done.err
    assert [path for path in tmp_path.rglob("*") if path.is_file() and path.name != ".lock"] == []


@pytest.mark.skipif(not CASES.is_dir(), reason="needs the shared cases")
def test_the_damaged_database_of_the_shared_cases() -> None:
    assert "bad.db: file is not a database" in refusal(f"sqlite:///{CASES}/bad.db")
