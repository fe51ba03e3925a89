"""No secret of an address is written or printed, whatever a run leaves."""

from pathlib import Path

import pytest

from mrtask.errors import InputError, refuse, without_secrets
from pipeline.backends import runs
from tests.pipeline.harness import Cli, Workspace

SECRET = "s3cret"
PLAIN = ("http://host:5000/a", "s3://bucket/run", "sqlite:////data/a@b.db", "models:/m@champion", "a@b, F Mug@Sink")
TRACKING = f"postgresql://bob:{SECRET}@db.example.org/mlflow?sslmode=require&password={SECRET}"


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        (TRACKING, "postgresql://***@db.example.org/mlflow?sslmode=require&password=***"),
        ("http://u:p/w@@host:5000/x", "http://***@host:5000/x"),
        ("https://token@host/a", "https://***@host/a"),
        ("https://host/a?X-Amz-Signature=ab&part=1", "https://host/a?X-Amz-Signature=***&part=1"),
        *((plain, plain) for plain in PLAIN),
    ],
)
def test_secrets_of_addresses_are_left_out(address: str, shown: str) -> None:
    assert without_secrets(f"uri='{address}': no") == f"uri='{shown}': no"


def test_errors_show_no_secrets(capsys: pytest.CaptureFixture[str]) -> None:
    said = f"tracking.uri={TRACKING}: cannot be opened ({TRACKING})"
    refuse(said)
    assert SECRET not in capsys.readouterr().err
    assert SECRET not in str(InputError(said))


def test_a_sweep_with_a_password_in_its_address_leaves_it_nowhere(
    workspace: Workspace, cli: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    opened, store = runs.open_tracking, f"sqlite:///{workspace.path}/outputs/mlflow.db"
    monkeypatch.setattr(runs, "open_tracking", lambda uri, name: opened(store if uri == TRACKING else uri, name))
    target = workspace.path / "outputs" / "secret"
    done = cli(
        "evaluate", *workspace.overrides, "-m", "evaluation.robots=[1],[2]", "evaluation.trials_per_cell=1",
        f"tracking.uri='{TRACKING}'", f"output_dir={target}", cwd=workspace.path,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert SECRET not in done.out + done.err
    assert "postgresql://***@db.example.org" in (target / "multirun.yaml").read_text()
    written = [path for path in workspace.path.rglob("*") if path.is_file()]
    assert {"evaluation.json", "multirun.yaml", "mlflow.db", "index.html"} <= {path.name for path in written}
    assert [path for path in written if SECRET.encode() in path.read_bytes()] == []
