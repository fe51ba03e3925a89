"""Which stages keep others out of their output_dir."""

from importlib import import_module
from pathlib import Path

import pytest

from mrtask.cli import STAGES
from pipeline.store.folder import Folder, locked
from tests.pipeline.harness import Cli, Workspace

REAL_HOMES = {"realism": ("homes=procthor", "homes.files=[real.jsonl]")}
LEAVE_OUTPUT_DIR_ALONE = {"homes": "to draw", "dataset": "never", "train": "never"}


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_that_writes_into_output_dir_holds_it(
    stage: str, workspace: Workspace, cli: Cli, tmp_path: Path
) -> None:
    declared = import_module(f"pipeline.{stage}").STAGE.locks
    assert declared == LEAVE_OUTPUT_DIR_ALONE.get(stage, "always")
    if declared == "never":
        return
    with locked(Folder(str(tmp_path / "busy")), tmp_path):
        options = (*workspace.overrides, *REAL_HOMES.get(stage, ()), "draw=true", f"output_dir={tmp_path / 'busy'}")
        done = cli(stage, *options, cwd=workspace.path)
    assert done.code == 2 and "is in use by another run" in done.err
