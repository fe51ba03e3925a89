"""The page of `pipeline.priors`: what a wrong prior costs in a mission, and what adapting in the home recovers."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mrtask.analysis.page.charts import LINE, legend_below, panels, with_band
from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.rendering import Findings, render_page, study_section
from mrtask.analysis.page.style import BLACK, BLUE, GREY, NOTHING, ORANGE, house_style, planner_label
from mrtask.analysis.page.tables import Entry, Row, Table, block, cell_headings, estimate_entry, saved_entry
from mrtask.analysis.results.roles import BASELINES
from mrtask.analysis.results.statistics import EVERYTHING, Cell, Estimate
from mrtask.analysis.studies.calibration import LOSSES
from mrtask.analysis.studies.prior_study import CONTENTS_NAMES, PRIOR_NAMES, TRUTH, ArmRows, PriorStudy, negative
from mrtask.names import counted

PRIOR_COLORS = {"uniform": GREY, "procthor": ORANGE, "housekeep": BLUE, TRUTH: BLACK}
PANEL_IN = 4.6, 2.9


def render_priors(arms: Sequence[ArmRows], tasks: int, experiment: str) -> str:
    """Return the page.

    Args:
        tasks: the number of successive trials in one home.

    Raises:
        ValueError: the episodes are not what `PriorStudy.of` demands.
    """
    study = PriorStudy.of(arms, tasks)
    margin = f"{planner_label(study.planner)} over the baselines"
    compared = any(set(BASELINES) & set(arm.episodes["planner"]) for arm in arms)
    parts: list[tuple[str, str, Callable[[PriorStudy, str], Table], bool, list[Picture]]] = [
        ("cost", "What a prior costs", cost_table, True, []),
        ("margin", margin, margin_table, compared, []),
        ("adapting", "What adapting wins back", adapting_table, any(arm.adapts for arm in arms), []),
        ("tasks", "Task by task", task_table, tasks > 1, [draw_tasks(study)] if tasks > 1 else []),
        ("belief", "How good the belief is", belief_table, True, [draw_calibration(study)]),
    ]
    sections = [
        study_section(anchor, title, [make(study, one) for one in study.contents], "prior", NOTES[anchor], pictures)
        for anchor, title, make, shown, pictures in parts
        if shown
    ]
    facts = [(f"{CONTENTS_NAMES[arm.contents]}: {arm.name}", " ".join(arm.overrides)) for arm in arms]
    return render_page(
        f"mrtask: priors of {experiment}",
        "What does a wrong prior cost, and does a belief that learns in the home win it back?",
        findings(study),
        [*sections, study_section("arms", "What each arm is", facts=facts)],
        episodes=sum(len(arm.episodes) for arm in arms),
    )


TASKS_CAPTION = (
    "Above: mean cost above that with the best prior on the same tasks, in per cent; solid with, dashed without "
    "adapting. Below: what adapting saves, with 95 % intervals over homes."
)
CALIBRATION_CAPTION = (
    "Above: log loss of the belief at the beginning of each task, per pair of container and object; solid with, dashed "
    "without adapting. Below: what was believed against what was true, in the last tasks, in tenths of the pairs."
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


def findings(study: PriorStudy) -> Findings:
    """Say what a prior learned elsewhere costs, and what adapting changes, over all cells."""
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
    return Findings(verdict, headline, tuple(sentences))


def _percent(estimate: Estimate | None) -> str:
    if estimate is None or not estimate.defined:
        return NOTHING
    interval = f" ({estimate.low:.1f} to {estimate.high:.1f})" if estimate.has_interval else ""
    return f"{estimate.value:.1f} %{interval}"


def cost_table(study: PriorStudy, contents: str) -> Table:
    """Tabulate mean costs with the best prior, and how far those with the others exceed them, by cell."""
    best = study.best(contents)

    def line(arm: ArmRows) -> tuple[str, list[Entry]]:
        if best is None or arm is best:
            costs = study.costs(arm)
            means = [costs[study.in_cell(costs.index, cell)].mean() for cell in study.cells]
            return f"{arm.name}: mean cost", [Entry(NOTHING if pd.isna(mean) else f"{mean:.1f} s") for mean in means]
        costs, least = study.costs(arm), study.costs(best)
        return arm.name, _by_cell(
            study, lambda cell: study.above(costs, least, study.in_cell(costs.index, cell)), False
        )

    against = f" above that with the {best.name} prior" if best else ""
    heading = f"cost of {planner_label(study.planner)}{against}"
    return Table(cell_headings(study.cells), _part(contents, heading, map(line, study.of_contents(contents))))


def margin_table(study: PriorStudy, contents: str) -> Table:
    """Tabulate the planner's improvement over each baseline, by prior and cell."""
    rows: tuple[Row, ...] = ()
    for baseline in BASELINES:
        lines = []
        for arm in study.of_contents(contents):
            if len(base := study.costs(arm, baseline)):
                lines.append((arm.name, _saved_by_cell(study, study.costs(arm), base)))
        rows += _part(contents, f"improvement over {planner_label(baseline)}", lines)
    return Table(cell_headings(study.cells), rows)


def adapting_table(study: PriorStudy, contents: str) -> Table:
    """Tabulate what adapting saves, on all tasks and on those about new objects.

    The table also says how much of a prior's cost that is.
    """
    pairs = [(PRIOR_NAMES[arm.prior], arm, without) for arm, without in study.pairs(contents)]

    def saved(arm: ArmRows, without: ArmRows, chosen: "pd.Series | None" = None) -> list[Entry]:
        return _saved_by_cell(study, study.costs(arm), study.costs(without), chosen)

    everywhere = ((name, saved(arm, without)) for name, arm, without in pairs)
    where_new = ((name, saved(arm, without, study.new_objects(without))) for name, arm, without in pairs)
    shares = (
        (name, [estimate_entry(study.won_back(arm, without, cell)) for cell in study.cells])
        for name, arm, without in pairs
    )
    return Table(
        cell_headings(study.cells),
        (
            *_part(contents, "saved by adapting", everywhere),
            *_part(contents, "saved in tasks about objects that nobody was sent for before in this home", where_new),
            *_part(contents, "share of the prior's cost that is won back", shares),
        ),
    )


def task_table(study: PriorStudy, contents: str) -> Table:
    """Tabulate what adapting saves in each task, and how far each prior is above the best one there."""
    pairs = study.pairs(contents)
    rows = _part(
        contents,
        "saved by adapting",
        ((PRIOR_NAMES[arm.prior], map(saved_entry, by_task(study, arm, without))) for arm, without in pairs),
    )
    if (best := study.best(contents)) is not None:
        others = [arm for arm in study.of_contents(contents) if arm is not best]
        lines = ((arm.name, map(_lost_entry, map(negative, by_task(study, arm, best)))) for arm in others)
        rows += _part(contents, f"cost above that with the {best.name} prior", lines)
    return Table(tuple(("task", str(number + 1)) for number in range(study.tasks)), rows)


def by_task(study: PriorStudy, arm: ArmRows, other: ArmRows) -> list[Estimate]:
    """Return what an arm saves against another in each task."""
    after, before = study.costs(arm), study.costs(other)
    return [study.saved(after, before, study.of_task(after.index, [number])) for number in range(study.tasks)]


def belief_table(study: PriorStudy, contents: str) -> Table:
    """Tabulate losses and calibration error before anything was seen and after, by prior.

    The table also says what adapting changes.
    """
    last = _last_tasks(study)
    shown = {"first task": [0]} | ({f"tasks {last[0] + 1} to {last[-1] + 1}": last} if study.tasks > 1 else {})
    columns = [(name, loss) for name in shown for loss in ("log loss", "Brier", "calibration error")]
    changed = [(loss, False) for loss in LOSSES] + [("log_loss", True)] if study.tasks > 1 else []
    if changed:
        columns += [("changed by adapting", name) for name in ("log loss", "Brier", "log loss, not seen before")]

    def entries(arm: ArmRows) -> Iterable[Entry]:
        for tasks in shown.values():
            found = study.calibrated(arm, tasks)
            yield from (_loss_entry(found.losses[name]) for name in LOSSES)
            yield Entry(f"{found.ece:.4f}")
        without = study.find(contents, arm.prior) if arm.adapts else None
        for name, unseen in changed:
            if without is None:
                yield Entry(NOTHING)
            else:
                change = study.changed(arm, without, name, last, unseen)
                yield _loss_entry(change, sign="+", higher_is_better=False)

    lines = ((arm.name, entries(arm)) for arm in study.of_contents(contents))
    return Table(tuple(columns), _part(contents, "of what was believed at the beginning of a task", lines))


def _part(contents: str, text: str, lines: Iterable[tuple[str, Iterable[Entry]]]) -> tuple[Row, ...]:
    return tuple(block(f"Contents of {CONTENTS_NAMES[contents]}: {text}", lines))


def _by_cell(study: PriorStudy, estimate: Callable[[Cell], Estimate], higher_is_better: bool) -> list[Entry]:
    return [estimate_entry(estimate(cell), higher_is_better=higher_is_better) for cell in study.cells]


def _saved_by_cell(
    study: PriorStudy, after: pd.Series, before: pd.Series, chosen: "pd.Series | None" = None
) -> list[Entry]:
    """Return what is saved in each cell, on all trials or on the chosen ones."""
    trials = after.index if chosen is None else after.index[chosen.reindex(after.index, fill_value=False)]
    return _by_cell(study, lambda cell: study.saved(after, before, study.in_cell(trials, cell)), True)


def _lost_entry(estimate: Estimate) -> Entry:
    return estimate_entry(estimate, higher_is_better=False)


def _loss_entry(estimate: Estimate, **looks: Any) -> Entry:
    return estimate_entry(estimate, 4, "", interval_digits=4, **looks)


@house_style()
def draw_tasks(study: PriorStudy) -> Picture:
    """Draw a column per contents: cost above the true prior, and what adapting saves, by task."""
    numbers = list(range(1, study.tasks + 1))
    figure, grid = _grid(study, "% above the best prior", "saved by adapting (%)")
    for contents, (upper, lower) in zip(study.contents, grid.T, strict=True):
        best = study.best(contents)
        for arm in study.of_contents(contents):
            if best is not None and arm is not best:
                upper.plot(numbers, [-estimate.value for estimate in by_task(study, arm, best)], **_look(arm))
        for arm, without in study.pairs(contents):
            with_band(lower, numbers, by_task(study, arm, without), (PRIOR_COLORS[arm.prior], "o"))
        for axes in (upper, lower):
            axes.axhline(0, color=BLACK, linewidth=0.8, zorder=0)
            axes.set_xticks(numbers)
        lower.set_xlabel("task in the home")
    return Picture("tasks", "Cost by task", TASKS_CAPTION, figure)


@house_style()
def draw_calibration(study: PriorStudy) -> Picture:
    """Draw a column per contents: log loss by task, and reliability in the last tasks."""
    numbers, last = list(range(1, study.tasks + 1)), _last_tasks(study)
    figure, grid = _grid(study, "log loss", "was true")
    for contents, (upper, lower) in zip(study.contents, grid.T, strict=True):
        for arm in study.of_contents(contents):
            losses = [study.loss(arm, "log_loss", number - 1).value for number in numbers]
            upper.plot(numbers, losses, **_look(arm))
            curve = study.calibrated(arm, last).curve
            lower.plot(curve["mean_prob"], curve["frequency"], **_look(arm))
        lower.axline((0, 0), slope=1, color=BLACK, linewidth=0.8, zorder=0)
        upper.set(xlabel="task in the home", xticks=numbers)
        lower.set(xlabel="believed", xlim=(0, None), ylim=(0, None))
    return Picture("belief", "Belief", CALIBRATION_CAPTION, figure)


def _grid(study: PriorStudy, upper: str, lower: str) -> tuple[Figure, NDArray[Any]]:
    """Return two rows of panels with these labels, a column per contents, and the legend of the priors."""
    width, height = PANEL_IN
    columns = len(study.contents)
    figure, grid = panels(width * columns, 2 * height + 0.4, 2, columns, sharey="row")
    for axes, contents in zip(grid[0], study.contents, strict=True):
        axes.set_title(f"contents of {CONTENTS_NAMES[contents]}")
    grid[0, 0].set_ylabel(upper)
    grid[1, 0].set_ylabel(lower)
    priors = dict.fromkeys(arm.prior for arm in study.arms)
    handles = [
        Line2D([], [], color=PRIOR_COLORS[prior], marker="o", label=f"{PRIOR_NAMES[prior]} prior") for prior in priors
    ]
    legend_below(figure, handles)
    return figure, grid


def _look(arm: ArmRows) -> dict[str, Any]:
    return {"color": PRIOR_COLORS[arm.prior], "linestyle": "-" if arm.adapts else "--", "marker": "o"} | LINE


def _last_tasks(study: PriorStudy) -> list[int]:
    """Return the second half of the tasks in a home."""
    return list(range(study.tasks // 2, study.tasks))
