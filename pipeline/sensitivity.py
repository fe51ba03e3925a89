"""Changes one factor of the experiment at a time, and draws what the planner saves against it: one curve per factor.

    python -m pipeline.sensitivity experiment=sensitivity

Factors (conf/sensitivity) are search and interaction time, errors of the likelihoods, team size and samples, or any key
whose values are numbers. The page is ``<output_dir>/sensitivity/index.html``. `pipeline.arms` says how arms share
evaluations; run again with more trials or values, the stage adds what is missing.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.sensitivity")

from collections.abc import Sequence
from functools import partial

from mrtask.analysis.studies.sensitivity import COMPARED, Curve, Point, render_sensitivity
from pipeline import evaluate
from pipeline.app.stage import Session, Stage
from pipeline.arms import Arm, Comparison, SharedRun, lay_out
from pipeline.base.config import Config
from pipeline.base.studies import Factor
from pipeline.store.folder import Folder
from pipeline.store.layout import SENSITIVITY
from pipeline.store.rows import read_episodes

WHAT = "sensitivity"


def job(config: Config) -> Comparison:
    """Lay out an arm for every value of every factor."""
    factors = config.sensitivity.factors
    shared = lay_out(config, [_arm(factor, value) for factor in factors for value in factor.values], COMPARED, WHAT)
    target = Folder(config.output_dir) / SENSITIVITY
    return Comparison(WHAT, shared, target, partial(_page, factors, config.experiment))


def _page(factors: Sequence[Factor], experiment: str, shared: Sequence[SharedRun], session: Session) -> str:
    rows = {arm: of_arm for one in shared for arm, of_arm in one.by_arm(read_episodes(one.episodes))}
    curves = [
        Curve(factor.name, factor.key, tuple(Point(value, rows[_arm(factor, value)[0]]) for value in factor.values))
        for factor in factors
    ]
    return render_sensitivity(curves, experiment)


def _arm(factor: Factor, value: float) -> Arm:
    text = f"{value:.10g}"
    return f"{factor.name} {text}", (f"{factor.key}={text}",)


STAGE = Stage(job, evaluate.check)
