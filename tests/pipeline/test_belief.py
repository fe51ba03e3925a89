"""Tasks one after the other in one home, and a belief that learns from one to the next."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mrtask.execution.trials import TrialOptions
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import AdaptOptions, adapted, sightings_of
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.rows import distinct_triples, label_rows, vocabulary
from mrtask.likelihood.table import build_table
from pipeline.base.specs import MapOptions, PlannerSpec
from pipeline.episodes import worker
from pipeline.episodes.plan import EvaluationPlan
from pipeline.episodes.worker import Context, EpisodeKey, Provenance, run_chain, run_one, run_warm
from tests.pipeline.configured import configured
from tests.pipeline.harness import Cli, Workspace

TASKS = 3


@pytest.fixture(scope="module")
def context(generated_homes: list[Home], tmp_path_factory: pytest.TempPathFactory) -> Context:
    """Two small homes, three tasks in each, and a belief that learns."""
    objects = vocabulary(generated_homes)
    rows = pd.concat([label_rows(home, objects) for home in generated_homes], ignore_index=True)
    homes = tuple(home for home in generated_homes if home.size_class == "small")[:2]
    return Context(
        homes=homes,
        table=build_table(FrequencyModel(distinct_triples(rows)), homes),
        maps=MapOptions(configured("map.resolution_m=0.1").map, tmp_path_factory.mktemp("cache")),
        seed=0,
        trials=TrialOptions(tasks_per_home=TASKS),
        planners={"learned_myopic": PlannerSpec("learned_myopic", "learned_myopic")},
        provenance=Provenance("1", {"learned_myopic": ""}, ""),
        adapt=AdaptOptions(),
    )


def keys(*numbers: int) -> tuple[EpisodeKey, ...]:
    return tuple(EpisodeKey("small", 1, number, "learned_myopic") for number in numbers)


def test_tasks_of_a_chain_are_in_one_home(context: Context) -> None:
    first, second = (run_chain(keys(*numbers), context) for numbers in ((0, 1, 2), (3, 4, 5)))
    assert len({row.home_id for row in first}) == len({row.home_id for row in second}) == 1
    assert first[0].home_id != second[0].home_id
    assert [row.trial_id for row in first] == ["small-1-000", "small-1-001", "small-1-002"]
    assert len({row.formula for row in first}) > 1


def test_each_task_begins_with_what_the_earlier_ones_showed(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    given, run = [], worker.run_episode

    def watched(trial, home, home_map, likelihood, *planner, **options):  # type: ignore[no-untyped-def]
        result = run(trial, home, home_map, likelihood, *planner, **options)
        given.append((trial, home, likelihood, result))
        return result

    monkeypatch.setattr(worker, "run_episode", watched)
    run_chain(keys(0, 1, 2), context)
    seen = []
    for task, (trial, home, likelihood, result) in enumerate(given):
        names = vocabulary([home])
        prior = context.table.matrix(home, names)
        expected = adapted(prior, names, home.container_kinds(), seen, task, AdaptOptions())
        np.testing.assert_allclose(likelihood, expected[:, [names.index(name) for name in trial.objects]], rtol=1e-6)
        assert any(result.searched)
        seen += sightings_of(home, task, result.searched, trial.objects)
    assert not np.allclose(given[2][2], context.table.matrix(given[2][1], given[2][0].objects))


def test_a_belief_that_does_not_adapt_runs_each_task_by_itself(context: Context) -> None:
    off = replace(context, adapt=None)
    alone = [run_one(key, off) for key in keys(0, 1, 2)]
    assert [row.cost_s for row in run_chain(keys(0, 1, 2), off)] == [row.cost_s for row in alone]
    assert run_chain(keys(0), context)[0].cost_s == alone[0].cost_s, "the first task is the same either way"


def test_a_pilot_times_no_workers_first_call(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    off, done = replace(context, adapt=None), list[str]()
    monkeypatch.setattr(worker, "warm", lambda key, context: done.append(f"warm {key.planner}"))
    monkeypatch.setattr(worker, "run_one", lambda key, context: done.append(f"run {key.number}"))
    for key in keys(0, 1):
        run_warm(key, off)
    assert done == ["warm learned_myopic", "run 0", "run 1"]


def test_what_is_run_in_one_go(context: Context) -> None:
    every = keys(*range(6))
    plan = EvaluationPlan(every, context, None, None, True, None)  # type: ignore[arg-type]
    assert plan.chains(every) == [every[:3], every[3:]]
    assert plan.chains(every[4:5]) == [every[3:]], "a chain with a gap is run from its beginning"
    off = replace(plan, context=replace(context, adapt=None))
    assert off.chains(every[4:]) == [(every[4],), (every[5],)]


def test_an_evaluation_with_tasks_in_one_home_goes_on_where_it_stopped(workspace: Workspace, cli: Cli) -> None:
    options = (*workspace.overrides, "evaluation.tasks_per_home=2", "output_dir=outputs/belief", "belief.adapt=true")
    planner = "evaluation.planners=[learned_myopic]"
    assert cli("evaluate", *options, planner, cwd=workspace.path).code == 0
    folder = workspace.path / "outputs/belief/episodes"
    rows = read(folder)
    assert rows.groupby(["size_class", "robots"])["home_id"].nunique().eq(1).all()
    refused = cli("evaluate", *options, planner, "belief.forget=0.5", cwd=workspace.path)
    assert refused.code == 2 and "belief" in refused.err
    lost = rows["trial_id"].str.endswith("1")
    for path in folder.glob("*.parquet"):
        frame = pd.read_parquet(path)
        frame[~frame["trial_id"].str.endswith("1")].to_parquet(path)
    assert lost.any() and len(read(folder)) == (~lost).sum()
    (workspace.path / "outputs/belief/evaluation.json").unlink()
    again = cli("evaluate", *options, planner, cwd=workspace.path)
    assert again.code == 0, again.err
    pd.testing.assert_frame_equal(read(folder), rows)
    # The second task in a home began with what the first had shown: it is replayed from there, and so comes out equal.
    replayed = cli("replay", "trial_id=medium-1-001", "output_dir=outputs/belief", cwd=workspace.path)
    assert replayed.code == 0, replayed.err


def read(folder: Path) -> pd.DataFrame:
    """What the rows say, in the order of trials."""
    frame = pd.read_parquet(folder, columns=["trial_id", "home_id", "size_class", "robots", "objects", "cost_s"])
    return frame.sort_values("trial_id", ignore_index=True)
