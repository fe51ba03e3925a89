"""The sections of the report, one function each.

To add a section, write a function from `ReportData` to an HTML fragment and list it in `SECTIONS`; the page and its
navigation follow. A fragment is usually a template of its own, which lays out tables (`mrtask.analysis.columns.Table`)
and pictures with the macros of ``parts.html.jinja``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from mrtask.analysis import curves, facts, figures, gap, tables
from mrtask.analysis.columns import Table
from mrtask.analysis.findings import Findings, find, main_planner
from mrtask.analysis.replay import task_in_words
from mrtask.analysis.report_data import ReportData
from mrtask.analysis.result_table import planner_table
from mrtask.analysis.statistics import BASELINES, MIN_TRIALS_FOR_INTERVAL, RESAMPLES, RULE
from mrtask.analysis.style import NOTHING, counted, data_uri, planner_label, robot_color
from mrtask.analysis.templating import render_fragment
from mrtask.analysis.trajectories import baseline_beside, draw_trial, instructive_trials, task_objects
from mrtask.analysis.trial_browser import (
    PLOT_BOTTOM,
    PLOT_LEFT,
    PLOT_PAD,
    PLOT_SIZE,
    TrialBrowser,
    browse_trials,
    notable_trials,
    place,
)


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading and an entry in the navigation."""

    anchor: str
    link: str
    """The entry in the navigation."""
    title: str
    fragment: Callable[[ReportData], Markup | None]
    """Makes the HTML below the heading; None leaves the section out."""


@dataclass(frozen=True)
class Picture:
    """An embedded figure with its caption, which is also its text for those who cannot see it."""

    uri: str
    title: str
    caption: str


def paper_table_section(data: ReportData) -> Markup:
    """The paper's table with our results in it."""
    return render_fragment(
        "paper_table",
        paper_table=tables.paper_table(data.summary, data.published, data.planner),
        marks={"above": tables.ABOVE, "below": tables.BELOW, "level": tables.LEVEL},
    )


def variants_section(data: ReportData) -> Markup | None:
    """The variants of a sweep side by side, and each one's own answer."""
    if len(data.summaries) < 2:
        return None
    sample_curves = curves.sample_curves(data.episodes, data.planner)
    return render_fragment(
        "variants",
        by_variant=tables.variant_table(data.summaries, data.planner),
        samples_picture=_picture(
            curves.draw_sample_curves(sample_curves) if sample_curves else None,
            "Cost against samples",
            "Above: mean cost with 95 % bootstrap intervals, which say how much trials differ. Below: the same trials "
            "paired, so a band that excludes zero has more to gain from samples; cut off at 100 %. Dashed: planners "
            "that take no samples.",
        ),
        variant_picture=_picture(
            figures.sweep(data.summaries, data.planner, BASELINES) if data.planner else None,
            "Improvement by variant",
            "All team sizes together, 95 % paired bootstrap intervals.",
        ),
        findings=_variant_findings(data),
    )


def figures_section(data: ReportData) -> Markup:
    """The charts."""
    return render_fragment("figures", pictures=_charts(data))


def trajectories_section(data: ReportData) -> Markup | None:
    """Some episodes, drawn; None where none can be."""
    pictures = _trajectories(data)
    return render_fragment("trajectories", pictures=pictures) if pictures else None


def trials_section(data: ReportData) -> Markup | None:
    """Every trial as a point that leads to it, and the trials worth a look; None without episodes."""
    browser = browse_trials(data.rows, data.planner, data.homes, data.replays)
    if browser is None:
        return None
    notable = [
        {
            "pick": pick,
            "task": _task(data.rows, pick.trial_id),
            "outcomes": _outcomes(data.rows, pick.trial_id, browser),
        }
        for pick in notable_trials(data.rows, data.planner)
    ]
    return render_fragment(
        "trials",
        browser=browser,
        notable=notable,
        replays=data.replays,
        place=place,
        plot={"size": PLOT_SIZE, "left": PLOT_LEFT, "bottom": PLOT_SIZE - PLOT_BOTTOM, "pad": PLOT_PAD},
        output_dir=data.manifest.get("output_dir"),
        robot_colors=[robot_color(team - 1) for team in browser.robots],
    )


def planners_section(data: ReportData) -> Markup:
    """All planners over all episodes, and the main one against each reference."""
    return render_fragment(
        "planners",
        planner=planner_label(data.planner) if data.planner else None,
        planner_table=planner_table(data.summary, data.published),
        pair_table=tables.pair_table(data.summary, data.planner),
    )


def optimality_section(data: ReportData) -> Markup | None:
    """How far planners are from the best that any planner can reach; None where it was not measured."""
    if not data.optimality:
        return None
    return render_fragment("optimality", table=tables.optimality_table(data.optimality))


def gap_section(data: ReportData) -> Markup | None:
    """What the gap between planners and knowing everything is made of; None where the planners for that did not run."""
    ladder = gap.find_ladder(data.manifest, data.summary.planners)
    if ladder is None or not (gaps := gap.gaps_of(data.rows, data.summary, ladder, data.optimality)):
        return None
    return render_fragment(
        "gap",
        truth=planner_label(ladder.truth),
        model=planner_label(ladder.model),
        counted=data.manifest.get("true_likelihoods") == "counted",
        certified=any(one.certified for one in gaps),
        sentences=gap.gap_sentences(gaps),
        picture=_picture(
            gap.draw_gaps(gaps),
            "What the gap is made of",
            "Mean cost above known, by part; the stroke is the whole, which parts below zero draw back.",
        ),
        table=gap.gap_table(gaps),
    )


def model_section(data: ReportData) -> Markup:
    """What the likelihood model is and how good."""
    return render_fragment("model", model=data.model)


def homes_section(data: ReportData) -> Markup:
    """Where the homes come from."""
    return render_fragment("homes", facts=facts.homes_facts(data.manifest, data.episodes))


def run_section(data: ReportData) -> Markup:
    """How the run was made, and which episodes have no result."""
    return render_fragment(
        "run",
        facts=facts.run_facts(data.manifest, data.episodes),
        failures=facts.failure_table(data.episodes),
        episodes=len(data.episodes),
        config=facts.config_text(data.manifest),
    )


def method_section(data: ReportData) -> Markup:
    """How the numbers are computed, and the published ones that they stand beside."""
    return render_fragment(
        "method",
        resamples=RESAMPLES,
        least_for_interval=MIN_TRIALS_FOR_INTERVAL,
        citation=data.published.citation,
        citation_url=data.published.url,
        real_world_table=tables.real_world_table(data.published),
    )


SECTIONS: Sequence[Section] = (
    Section("table", "Table", "The paper's table", paper_table_section),
    Section("variants", "Variants", "The sweep's variants", variants_section),
    Section("figures", "Figures", "Figures", figures_section),
    Section("trajectories", "Trajectories", "Trajectories", trajectories_section),
    Section("trials", "Trials", "Trial by trial", trials_section),
    Section("planners", "Planners", "All planners, all episodes", planners_section),
    Section("optimality", "Optimality", "How far from optimal", optimality_section),
    Section("gap", "Gap", "What the gap is made of", gap_section),
    Section("model", "Likelihood model", "Likelihood model", model_section),
    Section("homes", "Homes", "Homes", homes_section),
    Section("run", "Run", "Run", run_section),
    Section("method", "Method", "Method", method_section),
)
"""In the order of the page."""


def _variant_findings(data: ReportData) -> dict[str, tuple[Findings, Table]]:
    """Each variant's own answer and paper table, for those that are not shown in full."""
    found = {}
    for variant, summary in data.summaries.items():
        planner = data.planner if data.planner in summary.planners else main_planner(summary.planners)
        answer = find(summary, data.published, planner)
        found[variant] = (answer, tables.paper_table(summary, data.published, planner))
    return found


def _charts(data: ReportData) -> list[Picture]:
    rows, summary, published, planner = data.rows, data.summary, data.published, data.planner
    drawn = [
        _picture(
            figures.improvements(summary, published, planner, BASELINES) if planner else None,
            "Improvement by home size and team size",
            "Share of the baseline's mean cost that is saved, with 95 % paired bootstrap intervals.",
        ),
        _picture(
            figures.mean_costs(summary, published),
            "Mean cost by team size",
            "95 % bootstrap intervals. Published means (dotted, hollow) are on the paper's own homes and tasks: "
            "compare improvements rather than costs.",
        ),
        _picture(
            figures.scatter(rows, summary, planner, BASELINES) if planner else None,
            "Planner against baseline, trial by trial",
            "One point per trial that both finished. In the shaded half, below the line, the planner is cheaper.",
        ),
        _picture(
            figures.planning_times(rows, summary.planners),
            "Planning time per decision",
            "Median and quartiles over episodes; whiskers from the 5th to the 95th percentile.",
        ),
        _picture(
            curves.by_team(rows, planner) if planner else None,
            "Cost and planning time by team size",
            f"All size classes together, bands are 95 % bootstrap intervals. {_where_search_helps(data)}",
        ),
    ]
    return [picture for picture in drawn if picture]


def _where_search_helps(data: ReportData) -> str:
    found = curves.worth_by_team(data.rows, data.planner, RULE) if data.planner else None
    if data.planner is None or found is None:
        return ""
    parts = [
        f"{how} with {', '.join(map(str, teams))}"
        for how, teams in (("clearly sooner", found.clear), ("not clearly sooner", found.unclear))
        if teams
    ]
    return f"Against {RULE}, {planner_label(data.planner)} is {' robots, '.join(parts)} robots."


def _trajectories(data: ReportData) -> list[Picture]:
    rows, planner = data.rows, data.planner
    if planner is None or "trace" not in rows.columns:
        return []
    baseline = baseline_beside(rows["planner"], planner)
    names = [planner] if baseline is None else [planner, baseline]
    pictures = []
    for pick in instructive_trials(rows, planner, baseline, data.homes.keys()):
        trial = {row["planner"]: row for row in rows[rows["trial_id"] == pick.trial_id].to_dict("records")}
        task = f"Task: {trial[planner]['formula']}." if "formula" in rows.columns else ""
        figure = draw_trial(data.homes[pick.home_id], {name: trial[name] for name in names})
        reason, team = f"{pick.reason[0].upper()}{pick.reason[1:]}", counted(trial[planner]["robots"], "robot")
        title = f"{reason}: trial {pick.trial_id}, {team}"
        pictures.append(Picture(data_uri(figure), title, f"{task} Home {pick.home_id}.".strip()))
    return pictures


def _task(rows: pd.DataFrame, trial_id: str) -> str:
    """A trial's task in words; empty where the rows do not say."""
    if not {"template", "formula", "objects"} <= set(rows.columns):
        return ""
    of_trial = rows[(rows["trial_id"] == trial_id) & rows["formula"].notna()]
    if of_trial.empty:
        return ""
    first = of_trial.iloc[0]
    return task_in_words(str(first["template"]), str(first["formula"]), task_objects(first["objects"]))


def _outcomes(rows: pd.DataFrame, trial_id: str, browser: TrialBrowser) -> list[str]:
    """What came of a trial with the planner and the baseline: seconds, or the status."""
    of_trial = rows[rows["trial_id"] == trial_id].to_dict("records")
    found = {
        row["planner"]: f"{row['cost_s']:.1f} s" if row["status"] == "accepted" else row["status"] for row in of_trial
    }
    return [found.get(name, NOTHING) for name in browser.compared]


def _picture(figure: Figure | None, title: str, caption: str) -> Picture | None:
    return Picture(data_uri(figure), title, caption) if figure is not None else None
