"""Goes from the configured protocol to the authors' one switch at a time, and says which moves the improvements.

Arms (conf/ablation): "paper", the experiment as configured; "paper + x" with one switch added; "authors" with all of
them; "authors - x" without one; and the steps from the paper's text to our planner. One page in <output_dir>/report.

Arms that differ in planners' options alone run on the same trials, as variants in one evaluation
(<output_dir>/runs/...): their rows are paired, planners that do not differ run once, and a run that is interrupted goes
on where it stopped. Arms with other trials are evaluations of their own.
"""

import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

from mrtask.analysis.ablation import COMPARED, WAITS, ArmRows, render_ablation, waiting_shares
from pipeline import evaluate
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base import console
from pipeline.base.config import Ablation, Config, PlannerVariant, UserError, content_hash, with_overrides
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import EPISODES, REPORT, REPORT_INDEX
from pipeline.store.rows import read_episodes, read_traces

PAPER, AUTHORS = "paper", "authors"
RUNS = "runs"
"""The folder of the evaluations, each laid out like any other output_dir."""
OF_TRIALS = {"seed", "map", "homes", "evaluation"}
"""The parts of the configuration that decide which trials there are; planners' options are the rest of an arm."""


@dataclass(frozen=True)
class Protocol:
    """One arm: what it changes in the configuration."""

    name: str
    overrides: tuple[str, ...]
    in_detail: bool = False
    is_step: bool = False


@dataclass
class SharedRun:
    """One evaluation: all arms with the same trials."""

    config: Config
    variants: dict[str, PlannerVariant] = field(default_factory=dict)
    arms: list[tuple[Protocol, Mapping[str, str]]] = field(default_factory=list)
    """Each arm with the variant's name of every planner."""

    @property
    def trials_key(self) -> str:
        """What decides the trials."""
        return content_hash(self.config.model_dump(mode="json", include=OF_TRIALS))

    def add(self, arm: Protocol, config: Config) -> None:
        """Takes in an arm; a planner whose options an earlier arm has shares that one's rows."""
        names = {}
        for planner in COMPARED:
            variant = PlannerVariant(planner=planner, options=config.planner_options(planner))
            known = next((name for name, other in self.variants.items() if other == variant), None)
            names[planner] = known or f"{planner}:{_slug(arm.name)}"
            self.variants[names[planner]] = variant
        self.arms.append((arm, names))

    def configured(self) -> Config:
        """The evaluation's configuration."""
        evaluation = self.config.evaluation.model_copy(update={"planners": tuple(self.variants)})
        key = content_hash([self.trials_key, {name: one.model_dump() for name, one in self.variants.items()}])
        return self.config.model_copy(
            update={
                "evaluation": evaluation,
                "planner_variants": self.variants,
                "output_dir": f"{self.config.output_dir.rstrip('/')}/{RUNS}/{_slug(self.arms[0][0].name)}-{key}",
            }
        )


def run(config: Config, session: Session) -> None:
    """The stage."""
    began_s = time.monotonic()
    shared = lay_out(config)
    arms = sum(len(one.arms) for one in shared)
    console.headline("ablation", f"{arms} arms in {len(shared)} evaluations")
    configs = [one.configured() for one in shared]
    for one in configs:
        evaluate.run(one, session)
    if config.dry_run:
        return
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        rows = [arm for one, its in zip(shared, configs, strict=True) for arm in _arm_rows(one, its)]
        order = {arm.name: number for number, arm in enumerate(protocols(config.ablation))}
        rows.sort(key=lambda arm: order[arm.name])
        (folder / REPORT).write(REPORT_INDEX, render_ablation(rows, config.experiment).encode())
    console.result(folder / REPORT / REPORT_INDEX, time.monotonic() - began_s)


def protocols(ablation: Ablation) -> list[Protocol]:
    """All arms, in the order of the page."""
    switches = ablation.switches
    every = tuple(override for switch in switches for override in switch.overrides)
    found = [Protocol(PAPER, (), in_detail=True)]
    if ablation.added_alone:
        found += [Protocol(f"{PAPER} + {switch.name}", switch.overrides) for switch in switches]
    if switches:
        found.append(Protocol(AUTHORS, every, in_detail=True))
    for left_out in switches if ablation.taken_alone else ():
        rest = tuple(override for switch in switches if switch is not left_out for override in switch.overrides)
        found.append(Protocol(f"{AUTHORS} - {left_out.name}", rest))
    so_far = accumulate(step.overrides for step in ablation.steps)
    for step, overrides in zip(ablation.steps, so_far, strict=True):
        found.append(Protocol(f"step: {step.name}", overrides, in_detail=True, is_step=True))
    return found


def lay_out(config: Config) -> list[SharedRun]:
    """The evaluations that all arms need.

    Raises:
        UserError: an arm's overrides are a mistake, or two arms have one name.
    """
    runs: dict[str, SharedRun] = {}
    arms = protocols(config.ablation)
    names = [_slug(arm.name) for arm in arms]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UserError(f"ablation: two arms are called {', '.join(twice)}; give each a name of its own")
    for arm in arms:
        try:
            armed = with_overrides(config, arm.overrides)
        except UserError as error:
            raise UserError(f"ablation, arm {arm.name}: {error}") from error
        shared = SharedRun(armed)
        runs.setdefault(shared.trials_key, shared).add(arm, armed)
    return list(runs.values())


def _slug(name: str) -> str:
    """An arm's name as part of a folder's and of a planner variant's, which is also a metric's."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")


def _arm_rows(shared: SharedRun, config: Config) -> Iterator[ArmRows]:
    folder = Folder(config.output_dir) / EPISODES
    rows = read_episodes(folder)
    traces = read_traces(folder, set(rows["trial_id"]))
    traces[WAITS] = traces.pop(TRACE).map(waiting_shares, na_action="ignore").astype(object)
    rows = rows.merge(traces, on=["trial_id", "planner"], how="left")
    for arm, names in shared.arms:
        own: Mapping[str, Any] = {name: planner for planner, name in names.items()}
        of_arm = rows[rows["planner"].isin(own)]
        of_arm = of_arm.assign(planner=of_arm["planner"].map(own))
        yield ArmRows(arm.name, of_arm, arm.overrides, arm.in_detail, arm.is_step)


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.ablation")
