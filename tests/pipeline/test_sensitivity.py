"""A sensitivity page from the command line, in small."""

from pathlib import Path

import pandas as pd

from tests.pipeline.harness import Cli, Workspace

FACTORS = (
    "sensitivity.factors=[{name: search time, key: evaluation.search_time_s, values: [0, 5]}, "
    "{name: uniform share, key: likelihood.uniform_mix, values: [0, 1]}]"
)


def test_each_factor_is_changed_by_itself(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "sensitivity"
    small = [one for one in workspace.overrides if not one.startswith("evaluation.")]
    trials = ["evaluation.trials_per_cell=4", "evaluation.robots=[1]", "evaluation.size_classes=[medium]"]
    command = [*small, *trials, f"output_dir={out}"]
    finished = cli("sensitivity", *command, FACTORS, cwd=workspace.path)
    assert finished.code == 0, finished.err
    assert "4 arms in 2 evaluations" in finished.out
    page = (out / "sensitivity" / "index.html").read_text()
    assert "Search time" in page and "Uniform share" in page and page.count("data:image/svg+xml") == 2
    frames = {folder.name: pd.read_parquet(folder / "episodes") for folder in (out / "runs").iterdir()}
    base, slow = (next(one for name, one in frames.items() if name.startswith(f"search-time-{at}-")) for at in (0, 5))
    # As configured, and what is given to the planners changed on the same trials.
    costs = base.pivot(index="trial_id", columns="planner", values="cost_s")
    assert len(costs.columns) == 6 and len(costs) == 4
    rule = [name for name in costs if name.startswith("nonlearned_myopic")]
    assert (costs[rule[0]] == costs[rule[1]]).all()
    told = [name for name in costs if name.startswith("learned_myopic")]
    assert (costs[told[0]] != costs[told[1]]).any()
    slower = slow.pivot(index="trial_id", columns="planner", values="cost_s")
    assert (slower.filter(like="nonlearned").min(axis=1) > costs[rule[0]]).all()
    refused = cli("sensitivity", *command, FACTORS.replace("[0, 1]", "[0, 2]"), cwd=workspace.path)
    assert refused.code == 2
    assert "sensitivity, arm uniform share 2: likelihood.uniform_mix=2" in refused.err and "at most 1" in refused.err
