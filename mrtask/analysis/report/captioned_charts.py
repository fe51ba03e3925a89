"""The pictures of a run's report: which are drawn, with what title and caption."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from mrtask.analysis.drawing.trajectories import baseline_beside, draw_trial, instructive_trials
from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report import cost_profiles, result_charts, search_curves, template_charts
from mrtask.analysis.report.by_template import TemplateResult
from mrtask.analysis.report.report_data import ReportData
from mrtask.analysis.results.roles import BASELINES, RULE
from mrtask.names import counted


def picture(name: str, figure: Figure | None, title: str, caption: str) -> list[Picture]:
    """The picture of a figure, where there is one."""
    return [Picture(name, title, caption, figure)] if figure is not None else []


def overview_charts(data: ReportData) -> list[Picture]:
    """Improvements, costs, trial against trial, planning time."""
    rows, summary, published, planner = data.rows, data.summary, data.published, data.planner
    return [
        *picture(
            "improvement",
            result_charts.improvements(summary, published, planner, BASELINES) if planner else None,
            "Improvement by home size and team size",
            "Share of the baseline's mean cost that is saved, with 95 % paired bootstrap intervals.",
        ),
        *picture(
            "mean-cost",
            result_charts.mean_costs(summary, published),
            "Mean cost by team size",
            "95 % bootstrap intervals. Published means (dotted, hollow) are on the paper's own homes and tasks: "
            "compare improvements rather than costs.",
        ),
        *picture(
            "scatter",
            result_charts.scatter(rows, summary, planner, BASELINES) if planner else None,
            "Planner against baseline, trial by trial",
            "One point per trial that both finished. In the shaded half, below the line, the planner is cheaper.",
        ),
        *picture(
            "planning-time",
            result_charts.planning_times(rows, summary.planners),
            "Planning time per decision",
            "Median and quartiles over episodes; whiskers from the 5th to the 95th percentile.",
        ),
        *picture(
            "team-size",
            search_curves.by_team(rows, planner) if planner else None,
            "Cost and planning time by team size",
            f"All size classes together, bands are 95 % bootstrap intervals. {_where_search_helps(data)}".strip(),
        ),
    ]


def template_chart(results: Mapping[str, TemplateResult], planner: str) -> list[Picture]:
    """The improvement by template."""
    return picture(
        "templates",
        template_charts.template_improvements(results, planner),
        "Improvement by template",
        f"Of {planner_label(planner)} over each of the others, all cells together, with 95 % paired bootstrap "
        "intervals.",
    )


def wins_chart(data: ReportData) -> list[Picture]:
    """Wins, ties and losses by cell."""
    return picture(
        "wins",
        template_charts.wins(data.summary, data.planner) if data.planner else None,
        "Wins, ties and losses",
        f"Share of the trials that both finished in which {planner_label(data.planner or '')} was sooner (left), "
        "equally fast (middle), or later (right) than the planner named above the panel.",
    )


def distribution_charts(data: ReportData, ratios: cost_profiles.CostRatios | None) -> list[Picture]:
    """How costs are distributed: the profile over ratios, then the costs of each cell."""
    return [
        *picture(
            "profile",
            cost_profiles.draw_profile(ratios) if ratios else None,
            "Performance profile",
            "The share of trials that a planner finishes within a factor of the cheapest planner of the same trial "
            "(Dolan and Moré, 2002): at 1 how often it is the cheapest, further right how seldom it is far off. Higher "
            "is better.",
        ),
        *picture(
            "distribution",
            cost_profiles.draw_costs(data.rows, data.summary),
            "Cost distribution",
            "The share of a cell's trials finished at no more than this cost. A curve further left is better. Each "
            "axis ends at the 99th percentile of its panel: what a curve lacks there cost more, or failed.",
        ),
    ]


def trajectories(data: ReportData) -> list[Picture]:
    """The drawn episodes; none where there are no traces or homes."""
    rows, planner = data.rows, data.planner
    if planner is None or "trace" not in rows.columns:
        return []
    baseline = baseline_beside(rows["planner"], planner)
    names = [planner] if baseline is None else [planner, baseline]
    pictures = []
    for number, pick in enumerate(instructive_trials(rows, planner, baseline, data.homes.keys()), 1):
        trial = {row["planner"]: row for row in rows[rows["trial_id"] == pick.trial_id].to_dict("records")}
        task = f"Task: {trial[planner]['formula']}." if "formula" in rows.columns else ""
        figure = draw_trial(data.homes[pick.home_id], {name: trial[name] for name in names})
        reason, team = f"{pick.reason[0].upper()}{pick.reason[1:]}", counted(trial[planner]["robots"], "robot")
        title = f"{reason}: trial {pick.trial_id}, {team}"
        pictures.append(Picture(f"trajectory-{number}", title, f"{task} Home {pick.home_id}.".strip(), figure))
    return pictures


def _where_search_helps(data: ReportData) -> str:
    found = search_curves.worth_by_team(data.rows, data.planner, RULE) if data.planner else None
    if data.planner is None or found is None:
        return ""
    parts = [
        f"{how} with {', '.join(map(str, teams))}"
        for how, teams in (("clearly sooner", found.clear), ("not clearly sooner", found.unclear))
        if teams
    ]
    return f"Against {RULE}, {planner_label(data.planner)} is {' robots, '.join(parts)} robots."
