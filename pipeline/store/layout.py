"""Where everything is in an ``output_dir``; that of a sweep holds its cells, each laid out in the same way.

run.json              `RunIdentity`: everything that decides what the episodes' rows say
episodes/             the rows, `EpisodeRow`, as Parquet
evaluation.json       `EvaluationManifest`: written when all episodes are there
progress.json         `RunProgress`: how far the run is; written every few seconds
mlflow_run_id         the MLflow run under way, or the last one
stages.json           `StageTimes`: written by pipeline.reproduce
report/               index.html, table.csv, replays/, tables/, figures/, and `ReportKey` in manifest.json
optimality.csv        how far planners are from optimal, by trial: written by pipeline.optimality
replays/              a page for each trial that pipeline.replay has shown
sensitivity/          index.html, written by pipeline.sensitivity
homes/, realism/      the files of draw=true and of pipeline.realism
scenario/             the paper's apartments, if pipeline.scenario wrote into this folder: the report shows them
housekeep.csv         the measurements of pipeline.housekeep
cells/<cell>/         of a sweep: one output_dir for each cell
runs/<arm>-<key>/     of an ablation, a sensitivity page or priors: one output_dir for each evaluation
beliefs/<arm>.parquet in such a run of priors: what the team believed when each task began
"""

from pipeline.store.folder import Folder

IDENTITY = "run.json"
EPISODES = "episodes"
MANIFEST = "evaluation.json"
RUN_ID = "mlflow_run_id"
PROGRESS = "progress.json"
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
"""A folder with a file for each arm."""


def forget_episodes(folder: Folder) -> None:
    """Remove the episodes and everything made from them."""
    for name in (EPISODES, IDENTITY, PROGRESS, MANIFEST, REPORT, REPLAYS, STAGES, BELIEFS):
        folder.remove(name)


def cells(folder: Folder) -> list[Folder]:
    """Return the folders of a sweep's cells; none where there was no sweep."""
    return [folder / CELLS / name for name in (folder / CELLS).names()]
