"""The stages end to end in small: what they leave behind, what they skip, and what they refuse."""

import gzip
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import fsspec
import mlflow
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mrtask.execution.trials import objects_in
from mrtask.homes.download import DownloadError
from mrtask.homes.generator.house import generate_house
from pipeline.backends import registry, runs
from pipeline.backends.pool import Pool
from pipeline.base.config import UserError
from pipeline.inputs import floor_plans, homes
from pipeline.store import artifacts
from pipeline.store.episode_row import SCHEMA
from pipeline.store.records import EvaluationManifest, HomesManifest, StageTimes
from tests.pipeline.harness import ROOT, Cli, Workspace

TIMINGS = ["planning_s", "wall_s", "peak_memory_mb", "node"]
HOUSES = ("homes=procthor", "homes.train=1", "homes.validation=1", "homes.test=1")


def episodes(output_dir: Path) -> pd.DataFrame:
    """The rows without what depends on the machine, in a fixed order."""
    frame = pd.read_parquet(output_dir / "episodes").drop(columns=TIMINGS)
    return frame.sort_values(["trial_id", "planner"]).reset_index(drop=True)


def homes_manifest(folder: Path) -> HomesManifest:
    return HomesManifest.from_json((folder / artifacts.MANIFEST).read_bytes(), str(folder))


def manifest_of_homes(workspace: Workspace) -> HomesManifest:
    """That of the finished experiment; other tests in its folder may have made other sets of homes."""
    [found] = [one for folder in (workspace.path / "datasets" / "homes").iterdir()
               if (one := homes_manifest(folder)).homes == 24]  # fmt: skip
    return found


def evaluation_manifest(output_dir: Path) -> EvaluationManifest:
    return EvaluationManifest.from_json((output_dir / "evaluation.json").read_bytes(), str(output_dir))


def write_houses(path: Path, houses: list[Any]) -> Path:
    text = "".join(json.dumps(house) + "\n" for house in houses)
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def test_reproduce_leaves_every_result(workspace: Workspace) -> None:
    frame = pd.read_parquet(workspace.output_dir / "episodes")
    assert list(frame.columns) == SCHEMA.names
    assert len(frame) == 3 * 2 * 2 * 2
    assert not frame.duplicated(["trial_id", "planner"]).any()
    assert set(frame["status"]) == {"accepted"}
    assert (frame["cost_cells"] == frame["cost_s"] / 0.05).all()
    for column in ("home_id", "template", "formula", "seed", "start_x_m"):
        assert (frame.groupby("trial_id")[column].nunique() == 1).all(), f"planners differ in {column}"
    page = (workspace.output_dir / "report" / "index.html").read_text()
    figures = workspace.output_dir / "report" / "figures"
    assert len(list(figures.glob("*.svg"))) > 5 and not list(figures.glob("*.pdf"))
    assert "pouct" in page and "http://" not in page.replace("http://www.w3.org", "")
    manifest = evaluation_manifest(workspace.output_dir)
    assert manifest.expected_episodes == len(frame)
    assert (frame.groupby("planner")["config_hash"].nunique() == 1).all()
    assert manifest.reach.share > 0.95
    assert manifest.peak_memory_mb == pytest.approx(frame["peak_memory_mb"].max(), abs=0.1)
    assert set(StageTimes.from_json((workspace.output_dir / "stages.json").read_bytes(), "").seconds) == {
        "homes",
        "dataset",
        "train",
        "evaluate",
    }


def test_mlflow_has_dataset_model_and_report(workspace: Workspace) -> None:
    store = runs.open_tracking(f"sqlite:///{workspace.path}/outputs/mlflow.db", "mrtask")
    client = mlflow.MlflowClient()
    champion = client.get_model_version_by_alias(registry.MODEL_NAME, "champion")
    trained = client.get_run(champion.run_id)
    assert trained.data.tags["stage"] == "train" and trained.inputs.dataset_inputs
    of_evaluation = evaluation_manifest(workspace.output_dir).run_id
    evaluated = client.get_run(of_evaluation)
    assert evaluated.data.tags["stage"] == "evaluate"
    assert evaluated.data.tags["model_version"] == str(champion.version)
    metrics = evaluated.data.metrics
    rows = pd.read_parquet(workspace.output_dir / "episodes").query("size_class == 'small' and robots == 1")
    means = rows.groupby("planner")["cost_cells"].mean()
    assert metrics["pouct/small_1/cost_cells"] == pytest.approx(means["pouct"])
    assert metrics["pouct/small_1/percent_better_than_nonlearned_myopic"] == pytest.approx(
        100 * (1 - means["pouct"] / means["nonlearned_myopic"])
    )
    assert "pouct/small_1/cost_cells_low" not in metrics, "two trials are too few for an interval"
    all_rows = pd.read_parquet(workspace.output_dir / "episodes")
    overall = all_rows.groupby("planner")["cost_cells"].mean()
    assert metrics["pouct/all/percent_better_than_nonlearned_myopic"] == pytest.approx(
        100 * (1 - overall["pouct"] / overall["nonlearned_myopic"])
    )
    assert "pouct/all/percent_better_than_nonlearned_myopic_low" not in metrics, (
        "nine homes are too few for an interval"
    )
    assert metrics["pouct/all/decision_s"] > 0
    assert evaluated.info.run_name == "paper" and "" not in evaluated.data.tags.values()
    assert evaluated.data.tags["mlflow.note.content"].startswith("Over ")
    [homes] = evaluated.inputs.dataset_inputs
    profile = json.loads(homes.dataset.profile)
    assert homes.dataset.name == "evaluation-homes" and profile["num_rows"] == 9
    [model] = evaluated.inputs.model_inputs
    assert champion.source == f"models:/{model.model_id}"
    assert client.get_experiment(store.experiment_id).tags["mlflow.experimentKind"] == "custom_model_development"
    cost_s = pd.read_parquet(workspace.output_dir / "episodes").pivot(
        index="trial_id", columns="planner", values="cost_s"
    )
    saved = 100 * (1 - cost_s["pouct"] / cost_s["nonlearned_myopic"])
    assert metrics["pouct/all/median_percent_better_than_nonlearned_myopic"] == pytest.approx(saved.median())
    assert metrics["pouct/all/percent_of_trials_later_than_nonlearned_myopic"] == pytest.approx(
        100 * (saved < -1e-9).mean()
    )
    logged = {artifact.path for artifact in client.list_artifacts(of_evaluation, "report")}
    assert {"report/index.html", "report/table.csv", "report/tables", "report/figures"} <= logged
    table = client.load_table(store.experiment_id, "table.json", run_ids=[of_evaluation])
    written = pd.read_csv(workspace.output_dir / "report" / "table.csv")
    assert table["mean_cost_s"].to_numpy() == pytest.approx(written["mean_cost_s"].to_numpy(), rel=1e-5)


def test_homes_are_split_and_evaluation_homes_are_new(workspace: Workspace) -> None:
    split = manifest_of_homes(workspace).split
    assert [len(ids) for ids in (split.train, split.validation, split.test)] == [12, 3, 9]
    assert len({*split.train, *split.validation, *split.test}) == 24
    assert set(episodes(workspace.output_dir)["home_id"]) <= set(split.test)


def test_a_second_run_does_nothing_again(workspace: Workspace, cli: Cli) -> None:
    before = {path: path.stat().st_mtime_ns for path in workspace.output_dir.rglob("*.*") if path.name != ".lock"}
    again = cli("reproduce", *workspace.overrides, cwd=workspace.path)
    assert again.code == 0
    assert again.out.count("(unchanged, skipped)") == 5
    assert "pouct 12/12" in " ".join(again.out.split()) and "pouct's mean time is" in again.out
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_same_rows_in_another_folder_and_order_of_planners(workspace: Workspace, cli: Cli) -> None:
    overrides = [*workspace.overrides, "evaluation.planners=[pouct,nonlearned_myopic]", "output_dir=outputs/other"]
    assert cli("evaluate", *overrides, cwd=workspace.path).code == 0
    pd.testing.assert_frame_equal(episodes(workspace.path / "outputs" / "other"), episodes(workspace.output_dir))


def test_a_changed_configuration_is_refused_with_the_difference(
    workspace: Workspace, cli: Cli, copied_output: Path
) -> None:
    common = [*workspace.overrides, f"output_dir={copied_output}"]
    refused = cli("evaluate", *common, "seed=7", "planner.pouct.samples=30", cwd=workspace.path)
    assert refused.code == 2
    assert "planner.pouct.samples: was 20, now 30" in refused.err
    assert "seed: was 0, now 7" in refused.err
    assert "overwrite=true" in refused.err
    anew = [*common, "planner.pouct.samples=30", "evaluation.trials_per_cell=1", "overwrite=true"]
    assert cli("evaluate", *anew, cwd=workspace.path).code == 0
    assert len(episodes(copied_output)) == 3 * 2 * 2


def test_missing_rows_are_run_and_no_others(workspace: Workspace, cli: Cli, copied_output: Path) -> None:
    whole = episodes(copied_output)
    [part] = (copied_output / "episodes").glob("*.parquet")
    kept = pd.read_parquet(part).iloc[::3].assign(planning_s=-1.0)
    part.unlink()
    pq.write_table(pa.Table.from_pandas(kept, SCHEMA, preserve_index=False), part.with_name("part-kept.parquet"))
    done = cli("evaluate", *workspace.overrides, f"output_dir={copied_output}", cwd=workspace.path)
    assert done.code == 0 and f"there already: {len(kept)} episodes" in done.out
    pd.testing.assert_frame_equal(episodes(copied_output), whole)
    assert (pd.read_parquet(copied_output / "episodes")["planning_s"] == -1.0).sum() == len(kept)


def test_a_manifest_of_another_version_is_written_anew(workspace: Workspace, cli: Cli, copied_output: Path) -> None:
    rows = pd.read_parquet(copied_output / "episodes")
    for name in ("evaluation.json", "stages.json"):
        (copied_output / name).write_text('{"version": 0}')
    common = [*workspace.overrides, f"output_dir={copied_output}"]
    refused = cli("report", *common, cwd=workspace.path)
    assert refused.code == 2
    assert "evaluation.json cannot be read" in refused.err
    assert "run python -m pipeline.evaluate with the same output_dir again" in refused.err
    assert cli("evaluate", *common, cwd=workspace.path).code == 0
    assert evaluation_manifest(copied_output).expected_episodes == len(rows)
    pd.testing.assert_frame_equal(pd.read_parquet(copied_output / "episodes"), rows)
    assert cli("report", *common, cwd=workspace.path).code == 0


def test_other_homes_for_evaluation(workspace: Workspace, cli: Cli) -> None:
    houses = [generate_house(seed, "small") for seed in range(3)]
    write_houses(workspace.path / "others.jsonl.gz", [{"name": "no house"}, *houses])
    done = cli(
        "evaluate",
        *workspace.overrides,
        "evaluation.homes.files=[others.jsonl.gz]",
        "evaluation.homes.skip_faulty=true",
        "evaluation.size_classes=[small]",
        "output_dir=outputs/others",
        cwd=workspace.path,
    )
    assert done.code == 0
    assert set(episodes(workspace.path / "outputs" / "others")["home_source"]) == {"others.jsonl.gz"}
    assert "faulty homes left out: 1; the first: others.jsonl.gz, line 1" in done.out
    assert evaluation_manifest(workspace.path / "outputs/others").homes.skipped == 1


def test_homes_of_the_training_are_left_out(workspace: Workspace, cli: Cli) -> None:
    manifest = manifest_of_homes(workspace)
    done = cli(
        "evaluate",
        *workspace.overrides,
        f"evaluation.homes.files=[{manifest.files[0]}]",
        "output_dir=outputs/all",
        cwd=workspace.path,
    )
    assert "15 evaluation homes left out: the model has seen them in training" in done.out
    assert set(episodes(workspace.path / "outputs" / "all")["home_id"]) <= set(manifest.split.test)


def test_results_in_a_store_behind_a_url(workspace: Workspace, cli: Cli) -> None:
    url = "output_dir=memory://bucket/run"
    assert cli("evaluate", *workspace.overrides, url, cwd=workspace.path).code == 0
    again = cli("evaluate", *workspace.overrides, url, cwd=workspace.path)
    assert "memory://bucket/run/episodes (unchanged, skipped)" in again.out
    assert cli("report", *workspace.overrides, url, cwd=workspace.path).code == 0
    store = fsspec.filesystem("memory")
    [part] = store.glob("/bucket/run/episodes/*.parquet")
    with store.open(part) as file:
        rows = pd.read_parquet(file).drop(columns=TIMINGS)
    pd.testing.assert_frame_equal(rows, episodes(workspace.output_dir))
    assert store.exists("/bucket/run/report/index.html")
    assert not (workspace.path / "memory:").exists()


def test_an_own_formula_runs_in_the_homes_that_can_serve_it(workspace: Workspace, cli: Cli) -> None:
    homes = evaluation_manifest(workspace.output_dir).homes.read_from.read()
    test = manifest_of_homes(workspace).split.test
    small = [home for home in homes if home.id in test and home.size_class == "small"]
    rare = next(name for name in sorted(objects_in(small)) if sum(name in objects_in([home]) for home in small) == 1)
    options = [*workspace.overrides, "evaluation.size_classes=[small]", f"evaluation.formula='F {rare}'"]
    done = cli("evaluate", *options, "output_dir=outputs/own", cwd=workspace.path)
    assert done.code == 0, done.err
    lacking = f"{len(small) - 1} of {len(small)} homes lack what the task needs"
    assert f"{lacking}: its trials are drawn among the others" in done.out
    frame = episodes(workspace.path / "outputs" / "own")
    assert set(frame["status"]) == {"accepted"} and frame["home_id"].nunique() == 1
    assert set(frame["formula"]) == {f"F {rare}"}
    nowhere = next(name for name in ("Watch", "Vase", "Kettle", "Boots") if name not in objects_in(small))
    for dry in ("dry_run=true", "dry_run=false"):
        refused = cli(
            "evaluate", *options, f"evaluation.formula='F {nowhere}'", dry, "output_dir=outputs/no", cwd=workspace.path
        )
        assert refused.code == 2
        assert f"unknown object '{nowhere}'" in refused.err or "no small home has what the task" in refused.err
    assert not (workspace.path / "outputs" / "no").exists()


@pytest.mark.parametrize("overwrite", ["false", "true"])
def test_a_start_that_fails_changes_nothing(
    workspace: Workspace, cli: Cli, copied_output: Path, monkeypatch: pytest.MonkeyPatch, overwrite: str
) -> None:
    def nobody(pool: Pool) -> None:
        raise UserError("cluster.address=ray://nowhere:1: nobody answers there")

    monkeypatch.setattr(Pool, "start", nobody)
    before = {path: path.read_bytes() for path in copied_output.rglob("*.*") if path.name != ".lock"}
    common = [*workspace.overrides, "evaluation.trials_per_cell=3", f"overwrite={overwrite}"]
    for target in (str(copied_output), "outputs/deep/new"):
        refused = cli("evaluate", *common, f"output_dir={target}", cwd=workspace.path)
        assert refused.code == 2 and "nobody answers there" in refused.err
    assert {path: path.read_bytes() for path in before} == before
    assert not (workspace.path / "outputs" / "deep").exists()


def test_without_a_model_nothing_is_left_behind(cli: Cli, tmp_path: Path) -> None:
    refused = cli("evaluate", "output_dir=outputs/bare")
    assert refused.code == 2 and "python -m pipeline.train trains one" in refused.err
    assert not list(tmp_path.iterdir())


def test_dry_run_tells_the_time_and_writes_nothing(workspace: Workspace, cli: Cli) -> None:
    done = cli("evaluate", *workspace.overrides, "--dry-run", "output_dir=outputs/dry", cwd=workspace.path)
    assert done.code == 0
    assert "24 episodes" in done.out and "no episode was written" in done.out
    assert not (workspace.path / "outputs" / "dry").exists()


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["evaluation.formula='F Mug & (F'"], ["F Mug & (F", "^"]),
        (["evaluation.formula='G Mug'"], ["G Mug", "^"]),
        (["evaluation.formula='F Mugg & FLaptop'"], ["did you mean 'Mug'?"]),
        (["evaluation.homes.files=[nowhere.jsonl]"], ["evaluation.homes.files: no such file", "nowhere.jsonl"]),
        (["evaluation.planners=[pouct,best]"], ["unknown planner 'best'", "nonlearned_myopic"]),
        (["planner.pouct.samples=-1"], ["samples must be at least 1"]),
        (["evaluation.robot=[1]"], ["evaluation.robot: no such key", "did you mean robots?"]),
        (["homes=procthor11k"], ["homes/procthor11k", "procthor10k"]),
        (["output_dir=file/run"], ["cannot write", "output_dir"]),
        (["evaluation.model_uri=models:/container-object-likelihood/99"], ["container-object-likelihood/99"]),
        (["tracking.uri=sqlite:///empty.db"], ["champion", "python -m pipeline.train"]),
        (["homes.test=1"], ["homes to evaluate on|home to evaluate on", "evaluation.size_classes"]),
    ],
)
def test_evaluate_refuses_bad_input(workspace: Workspace, cli: Cli, overrides: list[str], said: list[str]) -> None:
    (workspace.path / "file").touch()
    done = cli("evaluate", *workspace.overrides, "output_dir=outputs/bad", *overrides, cwd=workspace.path)
    assert done.code == 2
    assert "Traceback" not in done.err
    for part in said:
        assert any(choice in done.err for choice in part.split("|")), done.err
    assert not (workspace.path / "outputs" / "bad" / "episodes").exists()


def test_house_files_that_are_none_are_refused(cli: Cli, tmp_path: Path) -> None:
    houses = [generate_house(seed, "small") for seed in range(3)]
    whole = write_houses(tmp_path / "good.jsonl.gz", houses)
    (tmp_path / "cut.jsonl.gz").write_bytes(whole.read_bytes()[:-500])
    bare = [dict(house, objects=[]) for house in houses]
    write_houses(tmp_path / "bare.jsonl", bare)
    write_houses(tmp_path / "other.jsonl", [{"name": "no house"}])
    (tmp_path / "text.jsonl").write_text("hello\n")
    for name, said in [
        ("gone.jsonl", ["no such file", "gone.jsonl"]),
        ("cut.jsonl.gz", ["cut.jsonl.gz"]),
        ("bare.jsonl", ["bare.jsonl, line 1", "no container"]),
        ("other.jsonl", ["other.jsonl, line 1", "rooms"]),
        ("text.jsonl", ["text.jsonl, line 1"]),
    ]:
        done = cli("homes", *HOUSES, f"homes.files=[{name}]")
        assert done.code == 2, name
        assert "Traceback" not in done.err
        for part in said:
            assert part in done.err
    assert cli("homes", *HOUSES, "homes.files=[good.jsonl.gz]").code == 0
    few = cli("homes", *HOUSES, "homes.files=[good.jsonl.gz]", "homes.train=5")
    assert few.code == 2
    assert "7 homes are requested" in few.err and "homes.train" in few.err


def test_faulty_homes_are_left_out_and_counted_where_that_is_asked_for(cli: Cli, tmp_path: Path) -> None:
    houses = [generate_house(seed, "small") for seed in range(4)]
    write_houses(tmp_path / "some.jsonl", [houses[0], dict(houses[1], rooms=[]), *houses[2:], {"name": "no house"}])
    options = [*HOUSES, "homes.files=[some.jsonl]"]
    refused = cli("homes", *options)
    assert refused.code == 2
    assert "some.jsonl, line 2: rooms" in refused.err and "homes.skip_faulty=true" in refused.err
    done = cli("homes", *options, "homes.skip_faulty=true")
    assert done.code == 0, done.err
    assert "faulty homes left out: 2; the first: some.jsonl, line 2: rooms" in done.out
    [folder] = (tmp_path / "datasets" / "homes").iterdir()
    manifest = homes_manifest(folder)
    assert (manifest.homes, manifest.skipped) == (3, 2)
    assert [fault.partition(": ")[0] for fault in manifest.faults] == ["some.jsonl, line 2", "some.jsonl, line 5"]
    write_houses(tmp_path / "none.jsonl", [{"name": "no house"}])
    none = cli("homes", *HOUSES, "homes.files=[none.jsonl]", "homes.skip_faulty=true")
    assert none.code == 2
    assert "no home can be used, all 1 are faulty; the first: none.jsonl, line 1" in none.err


def test_floor_plans_are_drawn(workspace: Workspace, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floor_plans, "DRAWN_PER_CLASS", 1)
    done = cli("homes", *workspace.overrides, "draw=true", "output_dir=outputs/drawn", cwd=workspace.path)
    assert done.code == 0
    drawn = sorted(path.name for path in (workspace.path / "outputs" / "drawn" / "homes").iterdir())
    assert len(drawn) == 2 * (3 + 1)
    assert {name.partition("-")[0] for name in drawn} == {"small", "medium", "large", "gallery.png", "gallery.svg"}
    assert {name.partition(".")[2] for name in drawn} == {"png", "svg"}


def test_report_without_episodes_is_refused(cli: Cli) -> None:
    done = cli("report", "output_dir=empty")
    assert done.code == 2
    assert "no finished evaluation in empty; run python -m pipeline.evaluate" in done.err


def test_a_run_of_another_store_is_reported_on(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    shutil.copytree(workspace.output_dir, tmp_path / "given", ignore=shutil.ignore_patterns("report", ".lock"))
    command = ("report", f"output_dir={tmp_path / 'given'}", f"tracking.uri=sqlite:///{tmp_path / 'own.db'}")
    done = cli(*command)
    assert done.code == 0, done.err
    assert "own.db does not hold this evaluation" in done.out
    assert (tmp_path / "given" / "report" / "index.html").is_file()
    figures = tmp_path / "given" / "report" / "figures"
    assert cli(*command, "pdf=true").code == 0
    assert len(list(figures.glob("*.pdf"))) == len(list(figures.glob("*.svg"))) > 5
    assert "unchanged, skipped" in cli(*command).out


def test_a_real_process_ends_with_one_message_and_no_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pipeline.evaluate", "evaluation.robots=[0]"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr == "error: evaluation.robots.0=0: must be at least 1\n"
    assert not list(tmp_path.iterdir())


def test_help_says_what_the_stage_does(cli: Cli) -> None:
    done = cli("train", "--help")
    assert done.code == 0
    assert "Trains the model" in done.out and "python -m pipeline.train" in done.out
    assert "trials_per_cell: 100" in done.out
    assert str(ROOT) not in done.out


def test_procthor10k_without_a_network_says_so(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*arguments: Any, **options: Any) -> None:
        raise DownloadError("train.jsonl.gz: cannot be reached; connect to the internet, or use homes=generated")

    monkeypatch.setattr(homes, "fetch_procthor10k", offline)
    done = cli("homes", "homes=procthor10k")
    assert done.code == 2
    assert done.err.startswith("error: homes=procthor10k: train.jsonl.gz: cannot be reached")


def test_procthor10k_is_read_from_what_was_downloaded(
    cli: Cli, tmp_path: Path, shared_homes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fetched(folder: Path, progress: bool) -> dict[str, Path]:
        names = ["procthor-4to10room.jsonl.gz", "asset-database.json"]
        return {name: shared_homes / name for name in names}

    monkeypatch.setattr(homes, "fetch_procthor10k", fetched)
    done = cli("homes", "homes=procthor10k", "homes.train=50", "homes.validation=5", "homes.test=20")
    assert done.code == 0
    assert "75 homes (4 small, 21 medium, 50 large)" in done.out
