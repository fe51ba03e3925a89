"""Sweeps: checked as a whole before they start, one folder and one MLflow child run per cell, one report."""

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mlflow
import pandas as pd
import pytest
from mlflow.entities import Run

from pipeline.app import sweep as sweeps
from pipeline.app.stage import Session, Stage
from pipeline.app.sweep import Sweep
from pipeline.backends import runs
from pipeline.base import console
from pipeline.base.config import UserError
from tests.pipeline.configured import configured
from tests.pipeline.harness import Cli, Workspace


def test_a_sweep_leaves_its_cells_child_runs_and_one_report(workspace: Workspace, cli: Cli) -> None:
    sweep = [
        "-m", *workspace.overrides, "planner.pouct.samples=5,10", "evaluation.robots=[1],[2]",
        "evaluation.size_classes=[small]", "output_dir=outputs/sweep", "cache_dir=outputs/cache",
    ]  # fmt: skip
    done = cli("evaluate", *sweep, cwd=workspace.path)
    assert done.code == 0, done.err
    target = workspace.path / "outputs" / "sweep"
    cells = sorted((target / "cells").iterdir())
    assert [cell.name for cell in cells] == [
        f"planner.pouct.samples={samples},evaluation.robots=_{robots}_" for samples in (10, 5) for robots in (1, 2)
    ]
    assert [len(pd.read_parquet(cell / "episodes")) for cell in cells] == [4] * 4
    second_began = (cells[3] / "run.json").stat().st_mtime
    maps = [path for path in (workspace.path / "outputs" / "cache" / "maps").rglob("*") if path.is_file()]
    assert maps and all(path.stat().st_mtime < second_began for path in maps), "the second cell mapped homes again"
    page = (target / "report" / "index.html").read_text()
    assert "Cost against samples" in page
    assert "planner.pouct.samples=5" in page and "planner.pouct.samples=10" in page
    parent, children = recorded(workspace, "sweep")
    assert parent.info.status == "FINISHED" and parent.info.run_name == "sweep"
    assert mlflow.MlflowClient().list_artifacts(parent.info.run_id, "report")
    name = "pouct/all/percent_better_than_nonlearned_myopic"
    assert {metric: value for metric, value in parent.data.metrics.items() if metric.endswith(name)} == {
        f"{re.sub('[^0-9a-z_.]', ' ', child.data.tags['sweep'])}/{name}": child.data.metrics[name] for child in children
    }
    assert len(children) == 4
    assert {child.info.run_name for child in children} == {
        f"samples={samples},robots=[{robots}]" for samples in (5, 10) for robots in (1, 2)
    }
    assert {child.data.params["planner.pouct.samples"] for child in children} == {"5", "10"}
    again = cli("evaluate", *sweep, cwd=workspace.path)
    assert again.out.count("/episodes (unchanged, skipped)") == 4


def recorded(workspace: Workspace, folder: str) -> tuple[Run, list[Run]]:
    """The run of the one sweep of an output folder, and the runs of its cells."""
    store = runs.open_tracking(f"sqlite:///{workspace.path}/outputs/mlflow.db", "mrtask")
    client = mlflow.MlflowClient()
    target = workspace.path / "outputs" / folder
    [parent] = client.search_runs([store.experiment_id], f"tags.stage = 'sweep' and tags.output_dir = '{target}'")
    of_parent = f"tags.mlflow.parentRunId = '{parent.info.run_id}'"
    return parent, list(client.search_runs([store.experiment_id], of_parent))


def test_one_wrong_cell_keeps_the_whole_sweep_from_starting(workspace: Workspace, cli: Cli) -> None:
    overrides = [*workspace.overrides, "-m", "planner.pouct.samples=5,-5,x", "output_dir=outputs/wrong"]
    done = cli("evaluate", *overrides, cwd=workspace.path)  # -m in the middle, as on any other command line
    assert done.code == 2
    assert "the sweep does not start" in done.err
    assert "cell planner.pouct.samples=-5: " in done.err and "cell planner.pouct.samples=x: " in done.err
    assert "== cell" not in done.out
    assert not (workspace.path / "outputs" / "wrong" / "cells").exists()


def test_a_cell_whose_files_are_missing_keeps_the_sweep_from_starting(workspace: Workspace, cli: Cli) -> None:
    homes = "evaluation.homes.files=[],[missing.jsonl]"
    done = cli("evaluate", "-m", *workspace.overrides, homes, "output_dir=outputs/nofile", cwd=workspace.path)
    assert done.code == 2 and "the sweep does not start:" in done.err and "missing.jsonl" in done.err
    assert "cell evaluation.homes.files=[missing.jsonl]: " in done.err
    assert "== cell" not in done.out and not (workspace.path / "outputs" / "nofile" / "cells").exists()


def test_a_cell_that_fails_leaves_the_others_running(workspace: Workspace, cli: Cli) -> None:
    sweep = [
        "-m", *workspace.overrides, "evaluation.homes.files=[small.jsonl]", "evaluation.size_classes=[large],[small]",
        "evaluation.robots=[1]", "output_dir=outputs/partly",
    ]  # fmt: skip
    make_small_homes(workspace.path / "small.jsonl")
    done = cli("evaluate", *sweep, cwd=workspace.path)
    assert done.code == 2
    assert "1 of 2 cells failed" in done.err and "no large home to evaluate on" in done.err
    parent, children = recorded(workspace, "partly")
    assert parent.info.status == "FAILED"
    status = {child.data.tags["sweep"]: child.info.status for child in children}
    assert status == {"evaluation.size_classes=[large]": "FAILED", "evaluation.size_classes=[small]": "FINISHED"}
    [failed] = [child for child in children if child.info.status == "FAILED"]
    assert "no large home" in failed.data.tags["mlflow.note.content"]
    cells = workspace.path / "outputs" / "partly" / "cells"
    assert len(pd.read_parquet(cells / "evaluation.size_classes=_small_" / "episodes")) == 4


def run_cells(*, fail: set[str], dry_run: bool = False, compares: bool = True) -> tuple[list[str], list[str], Sweep]:
    """Runs a made-up stage on cells ``seed=0`` to ``seed=2``: what it ran with, what was compared, and the sweep."""
    ran, compared = [], []

    @dataclass
    class Made:
        output_dir: str

        def run(self, session: Session) -> None:
            ran.append(f"{session.cell.text} {session.cell.title} {session.cell.parent_run_id} {self.output_dir}")
            if session.cell.title in fail:
                raise UserError("no home")

        def outline(self, session: Session) -> tuple[()]:
            return ()

    class Compared(Made):
        def run(self, session: Session) -> None:
            compared.append(f"{self.output_dir} {session.cell.parent_run_id}{session.cell.text}")

    compare = Stage(lambda config: Compared(config.output_dir), locks="never")
    stage = Stage(lambda config: Made(config.output_dir), locks="never", compare=compare if compares else None)
    config = configured(f"dry_run={dry_run}").model_copy(update={"output_dir": "/out"})
    sweep = Sweep(frozenset({"a.seed"}), {f"a.seed={seed}": config for seed in range(3)})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweeps, "_record", lambda config, overrides: Record())
        for seed in range(3):
            sweep.run_cell(stage, config, ["experiment=smoke", f"a.seed={seed}"], pool=None)
    return ran, compared, sweep


class Record:
    """Stands in for the sweep's run in MLflow."""

    run_id = "parent"

    def __init__(self) -> None:
        self.failures: list[tuple[str, str, str]] = []
        self.ended: list[BaseException | None] = []

    def note_failure(self, cell: str, title: str, error: str) -> None:
        self.failures.append((cell, title, error))

    def end(self, error: BaseException | None) -> None:
        self.ended.append(error)


def test_each_cell_knows_its_place_and_the_end_compares_once() -> None:
    ran, compared, sweep = run_cells(fail=set())
    assert ran == [f"a.seed={seed} seed={seed} parent /out/cells/a.seed={seed}" for seed in range(3)]
    assert compared == []
    sweep.end()
    assert compared == ["/out parent"] and sweep.record.ended == [None]


def test_cells_that_fail_are_listed_at_the_end_and_the_others_compared() -> None:
    _, compared, sweep = run_cells(fail={"seed=0", "seed=2"})
    assert sweep.failed == {"a.seed=0": "no home", "a.seed=2": "no home"}
    assert sweep.record.failures == [("a.seed=0", "seed=0", "no home"), ("a.seed=2", "seed=2", "no home")]
    with pytest.raises(SystemExit, match="2"):
        sweep.end()
    assert compared == ["/out parent"] and sweep.record.ended == []


class Workers:
    """Stands in for the pool."""

    slots = 2


def run_side_by_side(run: Callable[[Session], None], cells: int = 3) -> Sweep:
    """Runs a made-up stage that allows it on cells ``seed=0``, ``seed=1``, ..."""

    @dataclass
    class Made:
        def run(self, session: Session) -> None:
            run(session)

        def outline(self, session: Session) -> tuple[()]:
            return ()

    stage = Stage(lambda config: Made(), locks="never", side_by_side=True)
    config = configured()
    sweep = Sweep(frozenset({"a.seed"}), {f"a.seed={seed}": config for seed in range(cells)})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweeps, "_record", lambda config, overrides: Record())
        for seed in range(cells):
            sweep.run_cell(stage, config, [f"a.seed={seed}"], pool=Workers())  # type: ignore[arg-type]
    return sweep


def test_after_the_first_cell_as_many_run_at_once_as_there_are_workers(capsys: pytest.CaptureFixture[str]) -> None:
    meeting, met = threading.Barrier(2), list[str]()

    def run(session: Session) -> None:
        with console.Progress(5, "episodes") as progress:
            progress.update(2)
            if session.cell.title != "seed=0":
                meeting.wait(timeout=20)  # it breaks where the others do not run meanwhile
                met.append(console.under_way())
                meeting.wait(timeout=20)
                console.line("done")

    run_side_by_side(run, cells=5).end()
    assert met == ["4/10 episodes"] * 4
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "== cell 1/5: a.seed=0"
    assert sorted(said[1:]) == sorted(
        line
        for seed in range(1, 5)
        for line in (f"[seed={seed}] == cell {seed + 1}/5: a.seed={seed}", f"[seed={seed}]    done")
    )


def test_of_cells_that_run_at_once_mistakes_are_listed_and_a_bug_ends_the_sweep() -> None:
    def mistaken(session: Session) -> None:
        if session.cell.title != "seed=0":
            raise UserError("no home")

    sweep = run_side_by_side(mistaken)
    with pytest.raises(SystemExit, match="2"):
        sweep.end()
    assert sweep.failed == {"a.seed=1": "no home", "a.seed=2": "no home"}

    def buggy(session: Session) -> None:
        if session.cell.title != "seed=0":
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_side_by_side(buggy).end()


def test_nothing_is_compared_where_no_cell_left_anything() -> None:
    for fail, dry_run, compares in (
        ({"seed=0", "seed=1", "seed=2"}, False, True),
        (set(), True, True),
        (set(), False, False),
    ):
        _, compared, sweep = run_cells(fail=fail, dry_run=dry_run, compares=compares)
        if fail:
            with pytest.raises(SystemExit):
                sweep.end()
        else:
            sweep.end()
        assert compared == []


def make_small_homes(path: Path) -> None:
    """A file of small homes only."""
    from mrtask.homes.generator.house import generate_house
    from tests.pipeline.test_stages import write_houses

    write_houses(path, [generate_house(seed, "small") for seed in range(20, 23)])
