"""Changes one factor of the experiment at a time, and draws what the planner saves against it: one curve per factor.

    python -m pipeline.sensitivity experiment=sensitivity

Factors (conf/sensitivity) are search and interaction time, errors of the likelihoods, team size and samples, or any key
whose values are numbers. The page is ``<output_dir>/sensitivity/index.html``. How arms share evaluations stands in
`pipeline.arms`; run again with more trials or values, it adds what is missing.
"""

import time

from mrtask.analysis.studies.sensitivity import COMPARED, Curve, Point, render_sensitivity
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.arms import Arm, run_arms
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.base.studies import Factor
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import REPORT_INDEX, SENSITIVITY
from pipeline.store.rows import read_episodes

WHAT = "sensitivity"


def run(config: Config, session: Session) -> None:
    """The stage."""
    began_s = time.monotonic()
    factors = config.sensitivity.factors
    arms = [_arm(factor, value) for factor in factors for value in factor.values]
    shared = run_arms(config, arms, COMPARED, session, WHAT)
    if config.dry_run:
        return
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        rows = {arm: of_arm for one in shared for arm, of_arm in one.by_arm(read_episodes(one.episodes))}
        curves = [
            Curve(factor.name, factor.key, tuple(Point(value, rows[_arm(factor, value)[0]]) for value in factor.values))
            for factor in factors
        ]
        page = render_sensitivity(curves, config.experiment)
        (folder / SENSITIVITY).write(REPORT_INDEX, page.encode())
    console.result(folder / SENSITIVITY / REPORT_INDEX, time.monotonic() - began_s)


def _arm(factor: Factor, value: float) -> Arm:
    text = f"{value:.10g}"
    return f"{factor.name} {text}", (f"{factor.key}={text}",)


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.sensitivity")
