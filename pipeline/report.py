"""Writes the report of a run: ``<output_dir>/report/index.html``, one file that needs no network, and ``table.csv``.

On the output_dir of a sweep it compares the sweep's cells.
"""

import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import TypeAdapter

from mrtask.analysis.curves import BUDGET
from mrtask.analysis.report import render_report, trials_to_draw, write_report
from mrtask.homes.home import Home
from pipeline.app.main import main
from pipeline.app.sweep import CELLS
from pipeline.backends import tracking
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.episodes.plan import EPISODES, MANIFEST
from pipeline.optimality import read_optimality
from pipeline.store.folder import Folder, locked
from pipeline.store.home_files import HomeFiles
from pipeline.store.rows import TRACE, read_episodes, read_traces
from pipeline.store.version import source_hash

REPORT = "report"
STAGES = "stages.json"
KEY_FILE = "manifest.json"
INDEX = "index.html"
JUDGED_COLUMNS = ["trial_id", "planner", "status", "cost_s"]


def run(config: Config, pool: Pool) -> None:
    """The stage."""
    with locked(Folder(config.output_dir), config.cache_dir):
        report(config)


def report(config: Config, run_id: str | None = None) -> Folder:
    """Writes the report into the output folder unless it is there already.

    It is kept with the MLflow run ``run_id`` too; by default with that of the evaluation.
    """
    folder, began_s = Folder(config.output_dir), time.monotonic()
    episodes, manifest = collect(folder)
    console.headline("report", f"{len(episodes)} episodes")
    target = folder / REPORT
    optimality = read_optimality(folder)
    from_optimal = None if optimality is None else optimality.to_csv(index=False)
    key = {"key": content_hash([_digest(episodes), manifest, from_optimal, source_hash("mrtask/analysis")])}
    if target.read(KEY_FILE) == json.dumps(key).encode():
        console.skipped(target / INDEX)
        return target
    picks = trials_to_draw(episodes, manifest)
    drawn = _homes(manifest, {pick.home_id for pick in picks})
    episodes = _with_traces(episodes, folder, {pick.trial_id for pick in picks})
    with tempfile.TemporaryDirectory() as temporary:
        write_report(render_report(episodes, manifest, drawn, optimality), Path(temporary))
        target.upload(Path(temporary))
        if run_id := run_id or manifest.get("run_id"):
            store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
            tracking.log_artifact(tracking.Run(store, run_id), Path(temporary), REPORT)
    target.write(KEY_FILE, json.dumps(key).encode())
    console.result(target / INDEX, time.monotonic() - began_s)
    return target


def collect(folder: Folder) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The episodes and the manifest of a run, or of all cells of a sweep with a ``sweep`` column."""
    cells = [folder / CELLS / name for name in (folder / CELLS).names()]
    manifests = [(cell, _manifest(cell)) for cell in cells]
    finished = [(cell, manifest) for cell, manifest in manifests if manifest is not None]
    if finished:
        frames = [_episodes(cell, manifest).assign(sweep=manifest["sweep"]) for cell, manifest in finished]
        last = finished[-1][1]
        expected = sum(manifest["expected_episodes"] for _, manifest in finished)
        return pd.concat(frames, ignore_index=True), last | {
            "output_dir": folder.location,
            "expected_episodes": expected,
        }
    manifest = _manifest(folder)
    if manifest is None:
        raise UserError(
            f"no finished evaluation in {folder}; run python -m pipeline.evaluate with the same output_dir first"
        )
    stages = folder.read(STAGES)
    return _episodes(folder, manifest), manifest | ({"stages": json.loads(stages)} if stages else {})


def _episodes(folder: Folder, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """A run's episodes with how many samples a decision each planner was given."""
    rows = read_episodes(folder / EPISODES)
    budgets = {name: options.get("samples") for name, options in manifest["planner_options"].items()}
    return rows.assign(**{BUDGET: rows["planner"].map(budgets).astype("float64")})


def _with_traces(episodes: pd.DataFrame, folder: Folder, trials: set[str]) -> pd.DataFrame:
    """The episodes with a column ``trace``, filled for these trials."""
    in_sweep = "sweep" in episodes.columns
    traces = []
    for place in [folder / CELLS / name for name in (folder / CELLS).names()] if in_sweep else [folder]:
        manifest = _manifest(place)
        if manifest is not None:
            traces.append(read_traces(place / EPISODES, trials).assign(sweep=manifest["sweep"]))
    keys = ["sweep", "trial_id", "planner"] if in_sweep else ["trial_id", "planner"]
    return episodes.merge(pd.concat(traces)[[*keys, TRACE]], how="left", on=keys)


def _manifest(folder: Folder) -> dict[str, Any] | None:
    content = folder.read(MANIFEST)
    return None if content is None else dict(json.loads(content))


def _digest(episodes: pd.DataFrame) -> str:
    return content_hash(sorted(map(str, episodes[JUDGED_COLUMNS].itertuples(index=False, name=None))))


def _homes(manifest: Mapping[str, Any], ids: set[str]) -> dict[str, Home]:
    """The homes to be drawn; those whose files are gone are left out."""
    source = TypeAdapter[HomeFiles](HomeFiles).validate_python(manifest["homes"]["read_from"])
    if not all(path.is_file() for path in source.paths):
        console.line("the homes' files are gone: no episode is drawn")
        return {}
    return {home.id: home for home in source.read() if home.id in ids}


if __name__ == "__main__":
    main("pipeline.report")
