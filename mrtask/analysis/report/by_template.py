"""Results by template: one planner against the others on the trials whose task has the same form."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mrtask.analysis.page.tables import Column, Table, make_table
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.roles import REFERENCES
from mrtask.analysis.results.statistics import (
    UNDEFINED,
    Comparison,
    Estimate,
    PairedDraws,
    compare,
    improvement_of_means,
    paired_costs,
)
from mrtask.tasks.templates import TEMPLATES


@dataclass(frozen=True)
class TemplateResult:
    """One planner on the trials of one template, all cells together."""

    template: str
    trials: int
    finished: int
    cost_cells: Estimate
    comparisons: Mapping[str, Comparison]
    """By the planner it is compared with."""

    @property
    def label(self) -> str:
        """The template with its meaning, where it is one of ours."""
        known = TEMPLATES.get(self.template)
        return f"{self.template}: {known.meaning}" if known else self.template

    def improvement(self, reference: str) -> Estimate:
        """The improvement over another planner; `UNDEFINED` where the two are not compared."""
        found = self.comparisons.get(reference)
        return found.improvement if found else UNDEFINED


def results_by_template(rows: pd.DataFrame, planner: str | None) -> dict[str, TemplateResult]:
    """Template -> result, in the order of `TEMPLATES`, then by name; empty where the rows name no template."""
    if planner is None or "template" not in rows.columns:
        return {}
    found: dict[str, TemplateResult] = {}
    present = set(rows.loc[rows["planner"] == planner, "template"].dropna().astype(str))
    for template in (*(name for name in TEMPLATES if name in present), *sorted(present - set(TEMPLATES))):
        of_template = rows[rows["template"] == template]
        costs, cells = paired_costs(of_template), paired_costs(of_template, "cost_cells")[planner]
        own, place = costs[planner].to_numpy(), {name: index for index, name in enumerate(costs.columns)}
        estimate = PairedDraws(np.column_stack([costs.to_numpy(), cells.to_numpy()])).estimate
        found[template] = TemplateResult(
            template=template,
            trials=int((of_template["planner"] == planner).sum()),
            finished=int(costs[planner].notna().sum()),
            cost_cells=estimate(lambda means: means[..., 0], [len(place)]),
            comparisons={
                name: compare(
                    own, costs[name].to_numpy(), estimate(improvement_of_means, [place[planner], place[name]])
                )
                for name in REFERENCES
                if name in costs.columns and name != planner
            },
        )
    return found


def template_table(results: Mapping[str, TemplateResult]) -> Table | None:
    """The results by template; None where there are none."""
    if not results:
        return None
    references = [name for name in REFERENCES if any(name in result.comparisons for result in results.values())]
    columns = (
        Column[TemplateResult](lambda result: result.trials, ("trials", "run")),
        Column[TemplateResult](lambda result: result.finished, ("trials", "finished")),
        Column[TemplateResult](lambda result: result.cost_cells, ("mean cost", "cells"), digits=1),
        *(_improvement_over(name) for name in references),
    )
    return make_table(columns, [(result.label, result) for result in results.values()])


def _improvement_over(reference: str) -> Column[TemplateResult]:
    return Column(
        lambda result: result.improvement(reference),
        ("improvement over", planner_label(reference)),
        digits=1,
        unit=" %",
        higher_is_better=True,
    )
