"""Record our planners' episodes on a suite; run this when a planner, the simulation or the maps have changed.

python benchmarks/record_scores.py [pouct_paper ...]      (without names: all of them)
"""

import os
import sys
from pathlib import Path

import pandas as pd

from mrtask.sources import hash_folders
from mrtask.suite import recorded
from mrtask.suite.frozen import DEFAULT_SUITE
from mrtask.suite.score import Request, score_planner

FOLDER = Path(__file__).resolve().parents[1] / "mrtask" / "suite"


def main() -> None:
    """Run the planners and write their costs; the costs of the other planners stay."""
    suite = DEFAULT_SUITE
    path = FOLDER / recorded.file_name(suite)
    columns: dict[str, pd.Series] = {}
    if path.is_file():
        columns = dict(pd.read_csv(path, comment="#", index_col="trial_id").items())
    for name in sys.argv[1:] or recorded.PLANNERS:
        options = recorded.PLANNERS[name]
        episodes = score_planner(Request(name, options, suite, os.cpu_count() or 1))
        columns[name] = episodes.set_index("trial_id")["cost_s"]
        spent_s = episodes["planning_s"].sum()
        print(f"{name}: {episodes['status'].value_counts().to_dict()}, {spent_s:.1f} s of planning", flush=True)
    code = hash_folders("mrtask/planning", "mrtask/execution", "mrtask/maps")
    path.write_text(recorded.recorded_text(pd.DataFrame(columns), f"code {code}"), encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
