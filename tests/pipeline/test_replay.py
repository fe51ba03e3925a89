"""``python -m pipeline.replay``: an episode runs again from its row, equal, and becomes a page."""

import json
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.store.episode_row import SCHEMA
from tests.pipeline.harness import Cli, Workspace

TRIAL = "medium-2-000"


def change_rows(output_dir: Path, **changes: object) -> None:
    [part] = (output_dir / "episodes").glob("*.parquet")
    rows = pd.read_parquet(part)
    chosen = (rows["trial_id"] == TRIAL) & (rows["planner"] == "pouct")
    for column, value in changes.items():
        rows.loc[chosen, column] = value
    pq.write_table(pa.Table.from_pandas(rows, SCHEMA, preserve_index=False), part)


def test_every_planners_episode_replays_equal(workspace: Workspace, cli: Cli, copied_output: Path) -> None:
    # Whatever the command line says of planners and seeds, the run's own record holds.
    done = cli(
        "replay", f"trial_id={TRIAL}", f"output_dir={copied_output}", "seed=5", "planner.pouct.samples=7",
        cwd=workspace.path,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert f"trial {TRIAL} by pouct, nonlearned_myopic" in done.out
    page = (copied_output / "replays" / f"{TRIAL}.html").read_text()
    rows = pd.read_parquet(copied_output / "episodes").query("trial_id == @TRIAL").set_index("planner")
    for planner, row in rows.iterrows():
        assert f"<b>{row['cost_s']:.1f} s</b>" in page, planner
        assert f"decision 1 of {row['decisions']}" in page
    assert f"trial_id={TRIAL} planners=[pouct,nonlearned_myopic]" in page
    assert len(page.encode()) < 1_000_000


def test_an_episode_that_comes_out_otherwise_is_refused(workspace: Workspace, cli: Cli, copied_output: Path) -> None:
    command = ("replay", f"trial_id={TRIAL}", f"output_dir={copied_output}", "planners=[pouct]")
    change_rows(copied_output, cost_s=1.25)
    refused = cli(*command, cwd=workspace.path)
    assert refused.code == 2
    assert f"pouct on {TRIAL} does not replay to the stored episode (cost_s was 1.25, is now" in refused.err
    identity = copied_output / "run.json"
    identity.write_text(json.dumps(json.loads(identity.read_text()) | {"code": "0123456789abcdef"}))
    refused = cli(*command, cwd=workspace.path)
    assert "the code has changed since: check out" in refused.err
    assert not (copied_output / "replays").exists()


def test_an_episode_that_broke_off_cannot_be_watched(workspace: Workspace, cli: Cli, copied_output: Path) -> None:
    change_rows(copied_output, status="error", cost_s=None, error="KeyError: Mug")
    command = ("replay", f"trial_id={TRIAL}", f"output_dir={copied_output}")
    refused = cli(*command, "planners=[pouct]", cwd=workspace.path)
    assert refused.code == 2 and "broke off with status error" in refused.err and "KeyError: Mug" in refused.err
    assert "by nonlearned_myopic\n" in cli(*command, cwd=workspace.path).out


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ([], ["replay.trial_id: a value is needed", "trial_id=..."]),
        (["trial_id=large-9-000"], ["no such trial", "12 in all"]),
        ([f"trial_id={TRIAL}", "planners=[pouct,gredy]"], ["gredy has not run", "nonlearned_myopic"]),
        ([f"trial_id={TRIAL}", "output_dir=outputs/nowhere"], ["no episodes in outputs/nowhere", "pipeline.evaluate"]),
        (["trial=x"], ["trial: no such key"]),
    ],
)
def test_refuses_bad_input(workspace: Workspace, cli: Cli, overrides: list[str], said: list[str]) -> None:
    refused = cli("replay", *overrides, cwd=workspace.path)
    assert refused.code == 2
    for words in said:
        assert words in refused.err


def test_its_short_keys_are_its_own(workspace: Workspace, cli: Cli) -> None:
    refused = cli("report", "planners=[pouct]", cwd=workspace.path)
    assert refused.code == 2 and "planners: no such key" in refused.err
