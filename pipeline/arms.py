"""Arms: evaluations that differ in some overrides of one configuration, to be compared on one page.

Arms that differ only in planners' options or likelihoods run on the same trials, as variants in one evaluation
(<output_dir>/runs/...): their rows are paired, equal planners run once, and an interrupted run continues where it
stopped. Arms with other trials are evaluations of their own. A later command with more arms or trials adds what is
missing.
"""

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import pandas as pd

from mrtask.names import counted
from pipeline import evaluate
from pipeline.app.stage import Session
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash, with_overrides
from pipeline.base.sections import OtherLikelihood, PlannerVariant
from pipeline.episodes.outcome import NeverSucceeded
from pipeline.episodes.plan import WHICH_ROWS
from pipeline.store.folder import Folder
from pipeline.store.layout import EPISODES, REPORT_INDEX, RUNS

Arm = tuple[str, Sequence[str]]
"""A name and the overrides, ``key=value``."""
OF_TRIALS = {"seed", "map", "homes", "contents", "perception", "evaluation", "team", "belief"}
"""The parts of the configuration that decide which trials exist, and what is learned from one to the next; the
planners' options and likelihoods are the rest of an arm."""


@dataclass
class SharedRun:
    """One evaluation: all arms with the same trials."""

    config: Config
    """Of the trials; planners' options and likelihoods are those of all arms' common configuration."""
    first: str
    """The first arm that it was made for."""
    variants: dict[str, PlannerVariant] = field(default_factory=dict)
    arms: list[tuple[str, Mapping[str, str]]] = field(default_factory=list)
    """Each arm with the variant's name of every planner."""

    @property
    def trials_key(self) -> str:
        """What decides the trials."""
        return content_hash(self.config.model_dump(mode="json", include=OF_TRIALS))

    def add(self, arm: str, config: Config, planners: Sequence[str]) -> None:
        """Add an arm; a planner that equals one of an earlier arm shares its rows."""
        names = {}
        for planner in planners:
            spec = config.spec(planner)
            likelihood = OtherLikelihood(**asdict(spec.likelihood))
            variant = PlannerVariant(planner=spec.planner, options=dict(spec.options), likelihood=likelihood)
            known = next((name for name, other in self.variants.items() if other == variant), None)
            names[planner] = known or f"{planner}:{slug(arm)}"
            self.variants[names[planner]] = variant
        self.arms.append((arm, names))

    def configured(self) -> Config:
        """The evaluation's configuration."""
        evaluation = self.config.evaluation.model_copy(update={"planners": tuple(self.variants)})
        trials = self.config.model_dump(mode="json", include=OF_TRIALS | {"planner", "likelihood"})
        # Asked for more of the same trials, the run grows.
        trials["evaluation"] = {name: one for name, one in trials["evaluation"].items() if name not in WHICH_ROWS}
        folder = Folder(self.config.output_dir) / RUNS / f"{slug(self.first)}-{content_hash(trials)}"
        return self.config.model_copy(
            update={"evaluation": evaluation, "planner_variants": self.variants, "output_dir": folder.location}
        )

    @property
    def episodes(self) -> Folder:
        """Where its rows are."""
        return Folder(self.configured().output_dir) / EPISODES

    def by_arm(self, rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
        """Each arm with its part of the rows, under the planners' own names."""
        for arm, names in self.arms:
            own = {name: planner for planner, name in names.items()}
            of_arm = rows[rows["planner"].isin(own)]
            yield arm, of_arm.assign(planner=of_arm["planner"].map(own))


@dataclass(frozen=True)
class Comparison:
    """The job of a stage that runs arms, on the evaluations that they need, and compares them on one page.

    ``what`` names the stage in messages; ``render`` returns the page once all evaluations have run.
    """

    what: str
    shared: Sequence[SharedRun]
    target: Folder
    render: Callable[[Sequence[SharedRun], Session], str]

    @property
    def _text(self) -> str:
        return (
            f"{counted(sum(len(one.arms) for one in self.shared), 'arm')} in {counted(len(self.shared), 'evaluation')}"
        )

    def run(self, session: Session) -> None:
        """Run the evaluations and write the page.

        Raises:
            NeverSucceeded: no episode of an arm's planner was accepted; the page shows the others all the same.
        """
        began_s = time.monotonic()
        console.headline(self.what, self._text)
        failed: list[NeverSucceeded] = []
        for one in self.shared:
            try:
                evaluate.STAGE.start(one.configured(), session)
            except NeverSucceeded as error:
                failed.append(error)
        self.target.write(REPORT_INDEX, self.render(self.shared, session).encode())
        console.result(self.target / REPORT_INDEX, time.monotonic() - began_s)
        if failed:
            raise NeverSucceeded("\n".join(map(str, failed)))

    def outline(self, session: Session) -> Iterator[str]:
        """Say what would run, with a pilot of each evaluation."""
        yield f"would compare {self._text} on one page"
        for one in self.shared:
            yield f"{', '.join(arm for arm, _ in one.arms)}:"
            yield from evaluate.EvaluateJob(one.configured().evaluation_spec()).outline(session)


def lay_out(config: Config, arms: Sequence[Arm], planners: Sequence[str], what: str) -> list[SharedRun]:
    """Lay out the arms of ``what`` on as few evaluations as possible.

    Raises:
        UserError: an arm's overrides are a mistake, or two arms have one name.
    """
    runs: dict[str, SharedRun] = {}
    names = [slug(arm) for arm, _ in arms]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UserError(f"{what}: two arms are called {', '.join(twice)}; give each a name of its own")
    for arm, overrides in arms:
        try:
            armed = with_overrides(config, overrides)
        except UserError as error:
            raise UserError(f"{what}, arm {arm}: {error}") from error
        common = armed.model_copy(update={"planner": config.planner, "likelihood": config.likelihood})
        shared = SharedRun(common, arm)
        runs.setdefault(shared.trials_key, shared).add(arm, armed, planners)
    return list(runs.values())


def slug(name: str) -> str:
    """Return an arm's name as it can stand in the name of a folder, a planner variant and a metric."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")
