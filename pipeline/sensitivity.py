"""Changes one factor of the experiment at a time, and draws what the planner saves against it: one curve per factor.

    python -m pipeline.sensitivity experiment=sensitivity

Factors (conf/sensitivity) are search and interaction time, errors of the likelihoods, team size and samples, or any key
whose values are numbers. The page is ``<output_dir>/sensitivity/index.html``. `pipeline.arms` says how arms share
evaluations; run again with more trials or values, the stage adds what is missing.
"""

import time
from collections.abc import Iterator, Sequence

from mrtask.analysis.studies.sensitivity import COMPARED, Curve, Point, render_sensitivity
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.arms import Arm, lay_out, write_page
from pipeline.base.config import Config
from pipeline.base.studies import Factor
from pipeline.store.folder import Folder
from pipeline.store.layout import SENSITIVITY
from pipeline.store.rows import read_episodes

WHAT = "sensitivity"


def run(config: Config, session: Session) -> None:
    """Run every value of every factor and write the page."""
    began_s = time.monotonic()
    factors = config.sensitivity.factors
    comparison = lay_out(config, _arms(factors), COMPARED, WHAT)
    comparison.run(session)
    rows = {arm: of_arm for one in comparison.shared for arm, of_arm in one.by_arm(read_episodes(one.episodes))}
    curves = [
        Curve(factor.name, factor.key, tuple(Point(value, rows[_arm(factor, value)[0]]) for value in factor.values))
        for factor in factors
    ]
    write_page(Folder(config.output_dir) / SENSITIVITY, render_sensitivity(curves, config.experiment), began_s)


def outline(config: Config, session: Session) -> Iterator[str]:
    """Say which evaluations the factors would need."""
    yield from lay_out(config, _arms(config.sensitivity.factors), COMPARED, WHAT).outline(session)


def _arms(factors: Sequence[Factor]) -> list[Arm]:
    return [_arm(factor, value) for factor in factors for value in factor.values]


def _arm(factor: Factor, value: float) -> Arm:
    text = f"{value:.10g}"
    return f"{factor.name} {text}", (f"{factor.key}={text}",)


STAGE = Stage(run, outline)

if __name__ == "__main__":
    main("pipeline.sensitivity")
