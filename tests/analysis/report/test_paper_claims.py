"""Each verdict from rows made for it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report.paper_claims import Verdict, claims_table, count_verdicts, improvement_growth, judge_claims
from mrtask.analysis.report.real_world import driven_m, scenario_name, simulated_trial
from mrtask.analysis.report.report_data import collect_report_data
from mrtask.analysis.report.sections import claims_section
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.statistics import SEED, Bootstrap
from mrtask.execution.trace import Leg, Letter, Trace
from tests.analysis.report.test_coordination import WAITED, WENT_ON
from tests.analysis.synthetic import fail, make_episodes

OVER_NONLEARNED, OVER_LEARNED, GROWTH, COORDINATION = range(4)
PLANNERS = ("nonlearned_myopic", "learned_myopic", "pouct_paper")


def run(saved: dict[str, float], trials: int = 12, size_classes=("small", "medium", "large"), robots=(1, 2, 3)):
    """Episodes in which pouct_paper saves these shares of the baselines' cost by size class."""
    rng = np.random.default_rng(1)
    frame = make_episodes(trials, PLANNERS, size_classes, robots)
    base = frame["trial_id"].map(frame.groupby("trial_id")["cost_s"].mean())
    share = frame["size_class"].map(saved).where(frame["planner"] == "pouct_paper", 0.0)
    frame["cost_s"] = base * (1 - share) * rng.lognormal(0, 0.02, len(frame))
    frame["cost_cells"] = frame["cost_s"] * 20
    return frame


GROWING = {"small": 0.1, "medium": 0.25, "large": 0.4}


def judged(frame: pd.DataFrame, index: int, manifest=None, planner: str = "pouct_paper"):
    one = judge_claims(collect_report_data(frame, manifest or {}, {}))[index].judged[planner]
    return one.verdict, "; ".join(one.because)


def test_better_in_every_cell():
    verdict, because = judged(run(GROWING), OVER_LEARNED)
    assert verdict is Verdict.HOLDS and because.startswith("clearly less in 9 of 9 cells; least sure in small, ")


def test_worse_in_one_cell_is_a_contradiction():
    frame = run(GROWING)
    worse = (frame["planner"] == "pouct_paper") & (frame["size_class"] == "medium") & (frame["robots"] == 2)
    frame.loc[worse, ["cost_s", "cost_cells"]] *= 1.6
    verdict, because = judged(frame, OVER_NONLEARNED)
    assert verdict is Verdict.CONTRADICTED
    assert "clearly less in 8 of 9 cells; clearly more in medium, 2 robots" in because


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (run({"small": 0.0, "medium": 0.2, "large": 0.4}), "clearly less in 6 of 9 cells"),
        (run(GROWING, robots=(1, 2)), "3 cells not run"),
        (run(GROWING, trials=5), "clearly less in 0 of 9 cells"),
    ],
    ids=["no difference", "cells missing", "too few trials"],
)
def test_what_is_not_shown(frame, words):
    verdict, because = judged(frame, OVER_LEARNED)
    assert verdict is Verdict.NOT_SHOWN and words in because


def test_a_trial_that_only_the_baseline_finished_leaves_the_claim_open():
    frame = run(GROWING)
    lost = (frame["planner"] == "pouct_paper") & (frame["trial_id"] == "large-1-000")
    verdict, because = judged(fail(frame, lost), OVER_LEARNED)
    assert verdict is Verdict.NOT_SHOWN and "1 trial that only learned_myopic finished left out" in because


def test_what_did_not_run_is_not_judged():
    frame = run(GROWING)
    without = frame[frame["planner"] != "learned_myopic"]
    assert judged(without, OVER_LEARNED) == (Verdict.NOT_IN_RUN, "learned_myopic did not run")
    assert judged(without, GROWTH) == (Verdict.NOT_IN_RUN, "learned_myopic did not run")
    other_cells = run({"hall": 0.3}, size_classes=("hall",))
    assert judged(other_cells, OVER_LEARNED)[0] is Verdict.NOT_IN_RUN
    assert judged(run(GROWING, size_classes=("small",)), GROWTH)[0] is Verdict.NOT_IN_RUN
    ours = make_episodes(3, ["learned_myopic", "nonlearned_myopic", "pouct"])
    assert judged(ours, OVER_LEARNED) == (Verdict.NOT_IN_RUN, "pouct_paper did not run")
    assert judged(ours, OVER_LEARNED, planner="pouct")[0] is Verdict.NOT_SHOWN
    nothing = collect_report_data(frame.head(0), {}, {})
    assert {claim.judged["pouct_paper"].verdict for claim in judge_claims(nothing)} == {Verdict.NOT_IN_RUN}


@pytest.mark.parametrize(
    ("saved", "expected"),
    [
        (GROWING, Verdict.HOLDS),
        ({"small": 0.3, "medium": 0.3, "large": 0.3}, Verdict.NOT_SHOWN),
        ({"small": 0.1, "medium": 0.4, "large": 0.2}, Verdict.CONTRADICTED),
    ],
)
def test_growth(saved, expected):
    verdict, because = judged(run(saved), GROWTH)
    assert verdict is expected and "small to medium" in because and "medium to large" in because


def test_growth_of_two_classes_is_not_the_claim():
    verdict, because = judged(run(GROWING, size_classes=("small", "large")), GROWTH)
    assert verdict is Verdict.NOT_SHOWN and "only small and large homes ran" in because


def test_growth_against_the_normal_approximation():
    rng = np.random.default_rng(3)
    groups = []
    for saved in (0.1, 0.3):
        baseline = rng.uniform(10, 12, 400)
        groups.append(np.column_stack([baseline * (1 - saved) * rng.lognormal(0, 0.05, 400), baseline]))
    found = improvement_growth(Bootstrap(groups[0], seed=SEED), Bootstrap(groups[1], seed=SEED + 1), 1)
    values, variances = [], []
    for cost, base in (group.T for group in groups):
        ratio = cost.mean() / base.mean()
        values.append(100 * (1 - ratio))
        variances.append(1e4 * np.var(cost - ratio * base, ddof=1) / len(cost) / base.mean() ** 2)  # delta method
    half = 1.96 * np.sqrt(sum(variances))
    assert found.value == pytest.approx(values[1] - values[0])
    assert [found.low, found.high] == pytest.approx([found.value - half, found.value + half], abs=0.1 * half)


def test_coordination_needs_both_and_leads_to_a_trial():
    frame = run(GROWING, trials=2, size_classes=("small",), robots=(2,)).assign(formula="(!b U a) & F b")
    both = frame.assign(trace=np.where(frame["trial_id"] == "small-2-000", WAITED, WENT_ON))
    assert judged(both, COORDINATION)[0] is Verdict.HOLDS
    assert "2 such episodes; a robot waits in 50.0 % [" in judged(both, COORDINATION)[1]
    claim = judge_claims(collect_report_data(both, {"output_dir": "outputs/x"}, {}))[COORDINATION]
    assert [one.label for one in claim.evidence] == [
        "python -m pipeline.replay trial_id=small-2-000 output_dir=outputs/x",
        "python -m pipeline.replay trial_id=small-2-001 output_dir=outputs/x",
    ]
    assert judged(frame.assign(trace=WAITED), COORDINATION)[0] is Verdict.NOT_SHOWN
    assert judged(frame, COORDINATION)[0] is Verdict.NOT_IN_RUN


def apartment(length_m: float, objects: tuple[str, ...] = ("pillow", "remote")) -> Trace:
    legs = (Leg("move", 0, 1, "bed", None, ((0, 0), (length_m / 2, 0), (length_m, 0))),)
    letters = tuple(Letter(number, 0, name, "bed") for number, name in enumerate(objects))
    return Trace((0, 0), (legs, ()), letters)


def test_apartments():
    trial = load_published().real_world[0]
    assert scenario_name(trial) == "apartment1" and driven_m(apartment(4)) == [4, 0]
    data = collect_report_data(run(GROWING, 1, ("small",), (1,)), {"output_dir": "outputs/x"}, {})
    [*_, claim, _] = judge_claims(data)
    assert claim.judged["pouct_paper"].verdict is Verdict.NOT_IN_RUN
    command = claim.evidence[-1]
    assert command.label == "python -m pipeline.scenario name=apartment1 output_dir=outputs/x/scenario"

    def verdict(own: Trace, myopic: Trace):
        runs = {"pouct_paper": own, "nonlearned_myopic": myopic}
        found = {name: simulated_trial(trial, trace).as_dict() for name, trace in runs.items()}
        [*_, claim, _] = judge_claims(replace(data, manifest={"apartments": {trial.name: found}}))
        return claim.judged["pouct_paper"].verdict, " ".join(claim.judged["pouct_paper"].because)

    assert verdict(apartment(4), apartment(9))[0] is Verdict.HOLDS
    assert "4.00 m against 9.00 m of nonlearned_myopic" in verdict(apartment(4), apartment(9))[1]
    assert verdict(apartment(9), apartment(4))[0] is Verdict.CONTRADICTED
    assert verdict(apartment(4, ("pillow",)), apartment(9))[0] is Verdict.CONTRADICTED, "half the task is no task"
    assert verdict(apartment(4), apartment(9, ("remote",)))[0] is Verdict.NOT_IN_RUN
    assert verdict(apartment(4, ("teapot",)), apartment(9))[0] is Verdict.CONTRADICTED


def test_table_and_count():
    data = collect_report_data(run(GROWING), {}, {})
    claims = judge_claims(data)
    assert count_verdicts(claims, "pouct_paper") == "3 yes, 3 not in this run"
    table = claims_table(claims, data.judged)
    assert [row.entries[0].tone for row in table.rows] == ["good"] * 3 + [""] * 3
    assert [column[1] for column in table.columns] == ["pouct_paper"]


def test_a_team_of_robots_that_differ_in_speed_is_not_judged_by_the_papers_claims():
    frame = make_episodes(3, PLANNERS)
    assert claims_section(collect_report_data(frame, {}, {})) is not None
    data = collect_report_data(frame.assign(team="mixed", cost_cells=np.nan), {}, {})
    assert claims_section(data) is None
    assert any("differ in speed" in text for text in data.warnings)
