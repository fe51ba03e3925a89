"""What lies where in an ``output_dir``; a sweep's holds its cells, each of which is laid out in the same way.

run.json              `RunIdentity`: everything that decides what the episodes' rows say
episodes/             the rows, `EpisodeRow`, as Parquet
evaluation.json       `EvaluationManifest`: written when all episodes are there
mlflow_run_id         the MLflow run under way, or the last one
stages.json           `StageTimes`: written by pipeline.reproduce
report/               index.html, table.csv, replays/, tables/, figures/, and `ReportKey` in manifest.json
optimality.csv        how far planners are from optimal, by trial: written by pipeline.optimality
replays/              a page for each trial that pipeline.replay was asked for
sensitivity/          index.html, written by pipeline.sensitivity
homes/, realism/      what draw=true and pipeline.realism leave
scenario/             the paper's apartments, where pipeline.scenario was given this folder: the report judges them
housekeep.csv         what pipeline.housekeep measured
cells/<cell>/         of a sweep: one output_dir for each cell
runs/<arm>-<key>/     of an ablation, a sensitivity page or priors: one output_dir for each evaluation
beliefs/<arm>.parquet in such a run of priors: what was believed at the beginning of each task
"""

from pipeline.store.folder import Folder

IDENTITY = "run.json"
EPISODES = "episodes"
MANIFEST = "evaluation.json"
RUN_ID = "mlflow_run_id"
STAGES = "stages.json"
REPORT = "report"
REPORT_INDEX = "index.html"
REPORT_KEY = "manifest.json"
OPTIMALITY = "optimality.csv"
HOMES = "homes"
REALISM = "realism"
SENSITIVITY = "sensitivity"
REPLAYS = "replays"
HOUSEKEEP = "housekeep.csv"
SCENARIO = "scenario"
CELLS = "cells"
RUNS = "runs"
BELIEFS = "beliefs"
"""A folder: a file for each arm."""


def forget_episodes(folder: Folder) -> None:
    """Removes the episodes and all that was made from them."""
    for name in (EPISODES, IDENTITY, MANIFEST, REPORT, REPLAYS, STAGES, BELIEFS):
        folder.remove(name)


def runs(folder: Folder, name: str, key: str) -> Folder:
    """The folder of one of the evaluations that arms share."""
    return folder / RUNS / f"{name}-{key}"


def cells(folder: Folder) -> list[Folder]:
    """The folders of a sweep's cells; none where there was no sweep."""
    return [folder / CELLS / name for name in (folder / CELLS).names()]
