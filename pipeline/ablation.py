"""Goes from the configured protocol to the authors' one switch at a time, and shows which switch moves the results.

Arms (conf/ablation): "paper", the experiment as configured; "paper + x" with one switch added; "authors" with all of
them; "authors - x" without one; and the steps from the paper's text to our planner. One page in <output_dir>/report.

`pipeline.arms` says how arms share evaluations.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.ablation")

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

from mrtask.analysis.studies.ablation import COMPARED, WAITS, ArmRows, render_ablation, waiting_shares
from pipeline import evaluate
from pipeline.app.stage import Session, Stage
from pipeline.arms import Comparison, SharedRun, lay_out
from pipeline.base.config import Config
from pipeline.base.studies import Ablation
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder
from pipeline.store.layout import REPORT
from pipeline.store.rows import read_episodes, read_traces

PAPER, AUTHORS = "paper", "authors"
WHAT = "ablation"


@dataclass(frozen=True)
class Protocol:
    """One arm: what it changes in the configuration."""

    name: str
    overrides: tuple[str, ...]
    in_detail: bool = False
    is_step: bool = False
    against: str | None = None
    """The arm from which it differs by one switch."""


def job(config: Config) -> Comparison:
    """Lay out every arm."""
    arms = protocols(config.ablation)
    shared = lay_out(config, [(arm.name, arm.overrides) for arm in arms], COMPARED, WHAT)
    return Comparison(WHAT, shared, Folder(config.output_dir) / REPORT, partial(_page, arms, config.experiment))


def protocols(ablation: Ablation) -> list[Protocol]:
    """Return all arms, in the order of the page."""
    switches = ablation.switches
    every = tuple(override for switch in switches for override in switch.overrides)
    found = [Protocol(PAPER, (), in_detail=True)]
    if ablation.added_alone:
        found += [Protocol(f"{PAPER} + {switch.name}", switch.overrides, against=PAPER) for switch in switches]
    if switches:
        found.append(Protocol(AUTHORS, every, in_detail=True))
    for left_out in switches if ablation.taken_alone else ():
        rest = tuple(override for switch in switches if switch is not left_out for override in switch.overrides)
        found.append(Protocol(f"{AUTHORS} - {left_out.name}", rest, against=AUTHORS))
    so_far = accumulate(step.overrides for step in ablation.steps)
    for step, overrides in zip(ablation.steps, so_far, strict=True):
        found.append(Protocol(f"step: {step.name}", overrides, in_detail=True, is_step=True))
    return found


def _page(arms: Sequence[Protocol], experiment: str, shared: Sequence[SharedRun], session: Session) -> str:
    found = {arm.name: arm for one in shared for arm in _arm_rows(one, arms)}
    return render_ablation([found[arm.name] for arm in arms], experiment)


def _arm_rows(shared: SharedRun, arms: Sequence[Protocol]) -> Iterator[ArmRows]:
    rows = read_episodes(shared.episodes)
    traces = read_traces(shared.episodes, set(rows["trial_id"]))
    traces[WAITS] = traces.pop(TRACE).map(waiting_shares, na_action="ignore").astype(object)
    protocol_of = {arm.name: arm for arm in arms}
    for name, of_arm in shared.by_arm(rows.merge(traces, on=["trial_id", "planner"], how="left")):
        arm = protocol_of[name]
        yield ArmRows(name, of_arm, arm.overrides, arm.in_detail, arm.is_step, arm.against)


STAGE = Stage(job, evaluate.check)
