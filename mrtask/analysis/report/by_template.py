"""Results by template: one planner against the others on the trials whose tasks have the same form."""

from dataclasses import replace

import pandas as pd
from matplotlib.figure import Figure

from mrtask.analysis.page.charts import WIDTH_IN, panels, with_bars
from mrtask.analysis.page.style import BLACK, house_style, planner_label, planner_looks
from mrtask.analysis.page.tables import Column, Table, make_table
from mrtask.analysis.report.planner_table import COST_CELLS, EPISODES, Result, improvement_over
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.roles import REFERENCES
from mrtask.analysis.results.statistics import ALL_TEAMS, Summary, summarise_parts
from mrtask.tasks.templates import TEMPLATES

ROW_IN = 0.27
COLUMNS = (
    replace(EPISODES, heading=("trials", "run")),
    Column[Result](lambda result: result.found.accepted, ("trials", "finished")),
    replace(COST_CELLS, details=None),
)


def results_by_template(rows: pd.DataFrame, planner: str | None) -> Summary | None:
    """The statistics of each template the planner ran, as a cell ``(template, ALL_TEAMS)``; None without templates."""
    if planner is None or "template" not in rows.columns:
        return None
    templates = templates_in_order(rows[rows["planner"] == planner])
    parts = {(name, ALL_TEAMS): rows[rows["template"] == name] for name in templates}
    return summarise_parts(rows, templates, [ALL_TEAMS], parts) if parts else None


def templates_in_order(rows: pd.DataFrame) -> list[str]:
    """The templates of these rows: ours in the order of `TEMPLATES`, then any others by name."""
    present = set(rows["template"].dropna().astype(str))
    return [*(name for name in TEMPLATES if name in present), *sorted(present - set(TEMPLATES))]


def template_table(results: Summary, planner: str) -> Table:
    """The planner's results by template."""
    columns = (*COLUMNS, *(improvement_over(name) for name in _references(results, planner)))
    published = load_published()
    lines = ((_label(cell[0]), Result(results, published, cell, planner)) for cell in results.cells)
    return make_table(columns, lines)


@house_style()
def draw_templates(results: Summary, planner: str) -> Figure | None:
    """The improvement over each other planner with its interval, a line per template; None if nothing is compared."""
    references = _references(results, planner)
    cells = results.cells
    found = {name: [results.improvement(cell, planner, name) for cell in cells] for name in references}
    if not any(each.defined for estimates in found.values() for each in estimates):
        return None
    color, marker = planner_looks([planner])[planner]
    looks = {"fmt": marker, "color": color, "markersize": 5.5, "elinewidth": 1.4, "capsize": 2.5}
    height_in = ROW_IN * len(cells) + 1.0
    figure, (line,) = panels(WIDTH_IN, height_in, columns=len(references), sharex=True, sharey=True)
    for axes, reference in zip(line, references, strict=True):
        with_bars(axes, range(len(cells)), found[reference], sideways=True, **looks)
        axes.axvline(0, color=BLACK, linewidth=0.8, zorder=0)
        axes.set(title=f"over {planner_label(reference)}", xlabel="improvement (%)")
        axes.grid(axis="y", visible=False)
    line[0].set_yticks(range(len(cells)), [_label(template) for template, _ in cells])
    line[0].set_ylim(len(cells) - 0.5, -0.5)
    return figure


def _references(results: Summary, planner: str) -> list[str]:
    return [name for name in REFERENCES if results.compared(planner, name)]


def _label(template: str) -> str:
    """The template with its meaning, where it is one of ours."""
    return f"{template}: {TEMPLATES[template].meaning}" if template in TEMPLATES else template
