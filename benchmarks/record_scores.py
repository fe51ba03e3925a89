"""Records our planners' episodes on a suite; to be run when a planner, the simulation or the maps have changed.

python benchmarks/record_scores.py [mrtask-1]
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
    """Runs every planner and writes the costs."""
    suite = sys.argv[1] if len(sys.argv) > 1 else DEFAULT_SUITE
    columns = {}
    for name, options in recorded.PLANNERS.items():
        episodes = score_planner(Request(name, options, suite, os.cpu_count() or 1))
        columns[name] = episodes.set_index("trial_id")["cost_s"]
        spent_s = episodes["planning_s"].sum()
        print(f"{name}: {episodes['status'].value_counts().to_dict()}, {spent_s:.1f} s of planning", flush=True)
    path = FOLDER / recorded.file_name(suite)
    code = hash_folders("mrtask/planning", "mrtask/execution", "mrtask/maps")
    path.write_text(recorded.recorded_text(pd.DataFrame(columns), f"code {code}"), encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
