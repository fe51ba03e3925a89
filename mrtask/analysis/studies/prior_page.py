"""The page of `pipeline.priors`: what a wrong prior costs in a mission, and what adapting in the home wins back."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mrtask.analysis.page.columns import Entry, Row, Table
from mrtask.analysis.page.entries import cell_headings, percent_entry
from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.findings import Findings
from mrtask.analysis.page.style import BLACK, BLUE, GREY, NOTHING, ORANGE, house_style, new_figure, planner_label
from mrtask.analysis.page.templating import render_fragment, script_digest
from mrtask.analysis.results.statistics import BASELINES, EVERYTHING, Estimate
from mrtask.analysis.studies.calibration import LOSSES
from mrtask.analysis.studies.prior_study import CONTENTS_NAMES, PRIOR_NAMES, TRUTH, ArmRows, PriorStudy
from mrtask.names import counted

PRIOR_COLORS = {"uniform": GREY, "procthor": ORANGE, "housekeep": BLUE, TRUTH: BLACK}
PANEL_IN = 4.6, 2.9


def render_priors(arms: Sequence[ArmRows], tasks: int, experiment: str) -> str:
    """The page.

    Args:
        tasks: how many trials in a row are in one home.

    Raises:
        ValueError: the episodes are not what `PriorStudy.of` demands.
    """
    study = PriorStudy.of(arms, tasks)
    sections = [_section("cost", "What a prior costs", _tables(study, cost_table))]
    if any(set(BASELINES) & set(arm.episodes["planner"]) for arm in arms):
        title = f"{planner_label(study.planner)} over the baselines"
        sections.append(_section("margin", title, _tables(study, margin_table)))
    if any(arm.adapts for arm in arms):
        sections.append(_section("adapting", "What adapting wins back", _tables(study, adapting_table)))
    if tasks > 1:
        pictures = [Picture("tasks", "Cost by task", TASKS_CAPTION, draw_tasks(study))]
        sections.append(_section("tasks", "Task by task", _tables(study, task_table), pictures))
    pictures = [Picture("belief", "Belief", CALIBRATION_CAPTION, draw_calibration(study))]
    sections.append(_section("belief", "How good the belief is", _tables(study, belief_table), pictures))
    facts = [(f"{CONTENTS_NAMES[arm.contents]}: {arm.name}", " ".join(arm.overrides)) for arm in arms]
    body = render_fragment("ablation_arms", arms=facts)
    sections.append({"anchor": "arms", "link": "Arms", "title": "What each arm is", "body": body})
    return render_fragment(
        "page",
        title=f"mrtask: priors of {experiment}",
        script="",
        script_digest=script_digest(""),
        question="What does a wrong prior cost, and does a belief that learns in the home win it back?",
        findings=findings(study),
        warnings=[],
        variants=1,
        shown="",
        sections=sections,
        episodes=sum(len(arm.episodes) for arm in arms),
    )


TASKS_CAPTION = (
    "Above: mean cost above that with the best prior on the same tasks, in per cent; solid with, dashed without "
    "adapting. Below: what adapting saves, with 95 % intervals over homes."
)
CALIBRATION_CAPTION = (
    "Above: log loss of the belief at the beginning of each task, per pair of container and object; solid with, dashed "
    "without adapting. Below: what was believed against what was so, in the last tasks, in tenths of the pairs."
)
NOTES = {
    "cost": "Mean cost of the planner with each prior above its mean cost with the best prior, on the same trials: the "
    "true one, or where that was not run the one learned from homes with the same contents.",
    "margin": "The informed baseline has the same prior; the other looks at none.",
    "adapting": "Won back: the share of what the prior costs against the best one; it can exceed 100 %, since what was "
    "seen in the home is more than any prior knows.",
    "tasks": "Intervals are over homes.",
    "belief": "Of pairs of a container and an object of the task, given that the object is somewhere. The calibration "
    "error is over tenths of the pairs.",
}


def _section(anchor: str, title: str, tables: list[Table], pictures: Sequence[Picture] = ()) -> dict[str, object]:
    body = render_fragment("priors", tables=tables, note=NOTES[anchor], pictures=pictures)
    return {"anchor": anchor, "link": title, "title": title, "body": body}


def _tables(study: PriorStudy, make: Callable[[PriorStudy, str], Table]) -> list[Table]:
    return [make(study, contents) for contents in study.contents]


def _heading(contents: str, text: str) -> Row:
    return Row(f"Contents of {CONTENTS_NAMES[contents]}: {text}", heading=True)


def findings(study: PriorStudy) -> Findings:
    """What a prior learned elsewhere costs, and what adapting changes, over all cells."""
    sentences, verdicts = [], []
    for contents in study.contents:
        where = f"Contents of {CONTENTS_NAMES[contents]}"
        best = study.best(contents)
        for arm in study.of_contents(contents):
            if best is not None and arm is not best and not arm.adapts:
                above = study.above(study.costs(arm), study.costs(best))
                sentences.append(
                    f"{where}: the {arm.name} prior costs {_percent(above)} more than the {best.name} one."
                )
        for arm, without in study.pairs(contents):
            saved = study.saved(study.costs(arm), study.costs(without))
            back = study.won_back(arm, without, EVERYTHING)
            share = f", {_percent(back)} of what the prior costs" if back.defined else ""
            sentences.append(
                f"{where}: over {counted(study.tasks, 'task')} in a home adapting saves {_percent(saved)} with the "
                f"{PRIOR_NAMES[arm.prior]} prior{share}."
            )
            verdicts.append(saved)
    worse = sum(saved.high < 0 for saved in verdicts)
    better = sum(saved.low > 0 for saved in verdicts)
    verdict = f"Adapting helps in {better} of {len(verdicts)} pairs" if verdicts else "Priors compared"
    headline = f"It is clearly worse in {worse}." if verdicts else "No arm adapts here."
    return Findings(verdict, headline, tuple(sentences), ())


def _percent(estimate: Estimate | None) -> str:
    if estimate is None or not estimate.defined:
        return NOTHING
    interval = f" ({estimate.low:.1f} to {estimate.high:.1f})" if estimate.has_interval else ""
    return f"{estimate.value:.1f} %{interval}"


def cost_table(study: PriorStudy, contents: str) -> Table:
    """Mean costs with the best prior, and how far those with the others are above them, by cell."""
    best = study.best(contents)
    against = f" above that with the {best.name} prior" if best else ""
    rows = [_heading(contents, f"cost of {planner_label(study.planner)}{against}")]
    for arm in study.of_contents(contents):
        costs = study.costs(arm)
        if best is None or arm is best:
            means = (costs[study.in_cell(costs.index, cell)].mean() for cell in study.cells)
            rows.append(Row(f"{arm.name}: mean cost", tuple(_seconds_entry(mean) for mean in means)))
            continue
        above = (study.above(costs, study.costs(best), study.in_cell(costs.index, cell)) for cell in study.cells)
        rows.append(Row(arm.name, tuple(_toned(estimate, good_above=False) for estimate in above)))
    return Table(cell_headings(study.cells), tuple(rows))


def margin_table(study: PriorStudy, contents: str) -> Table:
    """The planner's improvement over each baseline, by prior and cell."""
    rows = []
    for baseline in BASELINES:
        lines = []
        for arm in study.of_contents(contents):
            costs, base = study.costs(arm), study.costs(arm, baseline)
            if len(base):
                saved = (study.saved(costs, base, study.in_cell(costs.index, cell)) for cell in study.cells)
                lines.append(Row(arm.name, tuple(_toned(estimate) for estimate in saved)))
        if lines:
            rows += [_heading(contents, f"improvement over {planner_label(baseline)}"), *lines]
    return Table(cell_headings(study.cells), tuple(rows))


def adapting_table(study: PriorStudy, contents: str) -> Table:
    """What adapting saves, on all tasks and on those about new objects, and how much of a prior's cost that is."""

    def saved(arm: ArmRows, without: ArmRows, mask: "pd.Series | None" = None) -> tuple[Entry, ...]:
        after, before = study.costs(arm), study.costs(without)
        cells = (study.in_cell(after.index, cell) for cell in study.cells)
        chosen = (cell if mask is None else cell & mask.reindex(cell.index, fill_value=False) for cell in cells)
        return tuple(_toned(study.saved(after, before, trials)) for trials in chosen)

    pairs = list(study.pairs(contents))
    rows = [_heading(contents, "saved by adapting"), *(Row(PRIOR_NAMES[a.prior], saved(a, w)) for a, w in pairs)]
    rows.append(_heading(contents, "saved in tasks about objects that nobody was sent for before in this home"))
    rows += [Row(PRIOR_NAMES[a.prior], saved(a, w, study.new_objects(w))) for a, w in pairs]
    rows.append(_heading(contents, "share of the prior's cost that is won back"))
    for arm, without in pairs:
        shares = (study.won_back(arm, without, cell) for cell in study.cells)
        rows.append(Row(PRIOR_NAMES[arm.prior], tuple(percent_entry(share) for share in shares)))
    return Table(cell_headings(study.cells), tuple(rows))


def task_table(study: PriorStudy, contents: str) -> Table:
    """What adapting saves in each task, and how far each prior is above the best one there."""
    numbers = range(study.tasks)
    rows = [_heading(contents, "saved by adapting")]
    for arm, without in study.pairs(contents):
        rows.append(Row(PRIOR_NAMES[arm.prior], tuple(map(_toned, by_task(study, arm, without)))))
    if (best := study.best(contents)) is not None:
        rows.append(_heading(contents, f"cost above that with the {best.name} prior"))
        for arm in study.of_contents(contents):
            if arm is not best:
                above = (_negative(estimate) for estimate in by_task(study, arm, best))
                rows.append(Row(arm.name, tuple(_toned(estimate, good_above=False) for estimate in above)))
    return Table(tuple(("task", str(number + 1)) for number in numbers), tuple(rows))


def by_task(study: PriorStudy, arm: ArmRows, other: ArmRows) -> list[Estimate]:
    """What an arm saves against another in each task."""
    after, before = study.costs(arm), study.costs(other)
    return [study.saved(after, before, study.of_task(after.index, [number])) for number in range(study.tasks)]


def belief_table(study: PriorStudy, contents: str) -> Table:
    """Losses and calibration error before anything was seen and after, and what adapting changes, by prior."""
    last = _last_tasks(study)
    columns = [("first task", "log loss"), ("first task", "Brier"), ("first task", "calibration error")]
    if study.tasks > 1:
        later = f"tasks {last[0] + 1} to {last[-1] + 1}"
        columns += [(later, "log loss"), (later, "Brier"), (later, "calibration error")]
        columns += [("changed by adapting", name) for name in ("log loss", "Brier", "log loss, not seen before")]
    rows = [_heading(contents, "of what was believed at the beginning of a task")]
    for arm in study.of_contents(contents):
        entries: list[Entry] = []
        for tasks in [[0], last][: 2 if study.tasks > 1 else 1]:
            found = study.calibrated(arm, tasks)
            entries += [_number(found.losses[name]) for name in LOSSES]
            entries.append(Entry(f"{found.ece:.4f}"))
        without = study.find(contents, arm.prior)
        if study.tasks > 1 and arm.adapts and without is not None:
            changes = [study.changed(arm, without, name, last) for name in LOSSES]
            changes.append(study.changed(arm, without, "log_loss", last, unseen=True))
            entries += [_number(estimate, signed=True) for estimate in changes]
        elif study.tasks > 1:
            entries += [Entry(NOTHING)] * (len(LOSSES) + 1)
        rows.append(Row(arm.name, tuple(entries)))
    return Table(tuple(columns), tuple(rows))


def draw_tasks(study: PriorStudy) -> Figure:
    """A column per contents: cost above the true prior, and what adapting saves, by task."""
    numbers = list(range(1, study.tasks + 1))
    with house_style():
        figure, grid = _grid(study)
        for contents, (upper, lower) in zip(study.contents, grid.T, strict=True):
            best = study.best(contents)
            for arm in study.of_contents(contents):
                if best is not None and arm is not best:
                    above = [-estimate.value for estimate in by_task(study, arm, best)]
                    upper.plot(numbers, above, **_look(arm))
            for arm, without in study.pairs(contents):
                _band(lower, numbers, by_task(study, arm, without), PRIOR_COLORS[arm.prior])
            for axes in (upper, lower):
                axes.axhline(0, color=BLACK, linewidth=0.8, zorder=0)
                axes.set_xticks(numbers)
            upper.set_title(f"contents of {CONTENTS_NAMES[contents]}")
            lower.set_xlabel("task in the home")
        grid[0, 0].set_ylabel("% above the best prior")
        grid[1, 0].set_ylabel("saved by adapting (%)")
    return figure


def draw_calibration(study: PriorStudy) -> Figure:
    """A column per contents: log loss by task, and reliability in the last tasks."""
    numbers, last = list(range(1, study.tasks + 1)), _last_tasks(study)
    with house_style():
        figure, grid = _grid(study)
        for contents, (upper, lower) in zip(study.contents, grid.T, strict=True):
            for arm in study.of_contents(contents):
                losses = [study.loss(arm, "log_loss", number - 1).value for number in numbers]
                upper.plot(numbers, losses, **_look(arm))
                curve = study.calibrated(arm, last).curve
                lower.plot(curve["mean_prob"], curve["frequency"], **_look(arm))
            lower.axline((0, 0), slope=1, color=BLACK, linewidth=0.8, zorder=0)
            upper.set_title(f"contents of {CONTENTS_NAMES[contents]}")
            upper.set(xlabel="task in the home", xticks=numbers)
            lower.set(xlabel="believed", xlim=(0, None), ylim=(0, None))
        grid[0, 0].set_ylabel("log loss")
        grid[1, 0].set_ylabel("was so")
    return figure


def _grid(study: PriorStudy) -> tuple[Figure, NDArray[Any]]:
    width, height = PANEL_IN
    figure = new_figure(width * len(study.contents), 2 * height + 0.4)
    grid = figure.subplots(2, len(study.contents), squeeze=False, sharey="row")
    priors = dict.fromkeys(arm.prior for arm in study.arms)
    handles = [Line2D([], [], color=PRIOR_COLORS[prior], marker="o", label=PRIOR_NAMES[prior]) for prior in priors]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), title="prior")
    return figure, grid


def _look(arm: ArmRows) -> dict[str, Any]:
    return {
        "color": PRIOR_COLORS[arm.prior],
        "linestyle": "-" if arm.adapts else "--",
        "marker": "o",
        "markersize": 4,
        "linewidth": 1.6,
    }


def _band(axes: Axes, numbers: Sequence[int], estimates: Sequence[Estimate], color: str) -> None:
    values, lows, highs = np.array([[each.value, each.low, each.high] for each in estimates]).T
    axes.plot(numbers, values, color=color, marker="o", markersize=4, linewidth=1.6)
    axes.fill_between(list(numbers), lows, highs, color=color, alpha=0.15, linewidth=0)


def _last_tasks(study: PriorStudy) -> list[int]:
    """The second half of the tasks in a home."""
    return list(range(study.tasks // 2, study.tasks))


def _negative(estimate: Estimate) -> Estimate:
    return Estimate(-estimate.value, -estimate.high, -estimate.low, estimate.n)


def _toned(estimate: Estimate, good_above: bool = True) -> Entry:
    entry = percent_entry(estimate)
    above, below = ("good", "bad") if good_above else ("bad", "good")
    return Entry(entry.value, entry.details, above if estimate.low > 0 else below if estimate.high < 0 else "")


def _number(estimate: Estimate, signed: bool = False) -> Entry:
    if not estimate.defined:
        return Entry(NOTHING)
    sign = "+" if signed else ""
    details = (f"[{estimate.low:{sign}.4f}, {estimate.high:{sign}.4f}]",) if estimate.has_interval else ()
    tone = ("good" if estimate.high < 0 else "bad" if estimate.low > 0 else "") if signed else ""
    return Entry(f"{estimate.value:{sign}.4f}", details, tone)


def _seconds_entry(mean: float) -> Entry:
    return Entry(f"{mean:.1f} s" if np.isfinite(mean) else NOTHING)
