"""The sections of the report, one function each.

To add a section, write a function from `ReportData` to a `Content` and list it in `SECTIONS`; the page and its
navigation follow, and so do the files for papers of the tables and pictures that the content names. Its HTML is usually
a template of its own, which lays out tables and pictures with the macros of ``parts.html.jinja``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import pandas as pd
from matplotlib.figure import Figure

from mrtask.analysis.drawing.replay_content import task_in_words
from mrtask.analysis.drawing.trajectories import draw_trial, instructive_trials, task_objects
from mrtask.analysis.page.exhibits import Content, Picture, ShownTable
from mrtask.analysis.page.rendering import Findings, render_fragment
from mrtask.analysis.page.style import NOTHING, planner_label, robot_color
from mrtask.analysis.page.tables import MARKS, Entry, Row, Table
from mrtask.analysis.report import cell_tables, cost_profiles, gap, overview_charts, run_facts, search_curves
from mrtask.analysis.report.answer import find
from mrtask.analysis.report.by_template import draw_templates, results_by_template, template_table
from mrtask.analysis.report.methods import bibtex, methods_latex, methods_markdown, methods_sentences
from mrtask.analysis.report.paper_claims import claims_table, count_verdicts, judge_claims
from mrtask.analysis.report.planner_table import planner_table
from mrtask.analysis.report.planner_words import (
    describe_planners,
    homes_sentence,
    known_sentence,
    model_sentence,
    protocol,
)
from mrtask.analysis.report.reliability import draw_reliability
from mrtask.analysis.report.report_data import ReportData
from mrtask.analysis.report.trial_browser import (
    PLOT_BOTTOM,
    PLOT_LEFT,
    PLOT_PAD,
    PLOT_SIZE,
    TrialBrowser,
    browse_trials,
    compared_planners,
    place,
)
from mrtask.analysis.report.wins import draw_wins, pair_table
from mrtask.analysis.results.episodes import without_cells
from mrtask.analysis.results.manifest import part
from mrtask.analysis.results.roles import BASELINES, RULE, main_planner
from mrtask.analysis.results.statistics import MIN_TRIALS_FOR_INTERVAL, RESAMPLES, SIGNIFICANT_P, home_repeats, homes_of
from mrtask.names import counted


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading and an entry in the navigation."""

    anchor: str
    link: str
    """The entry in the navigation."""
    title: str
    content: Callable[[ReportData], Content | None]
    """Makes the content below the heading; None leaves the section out."""


def _content(template: str, *exhibits: ShownTable | Picture | None, **values: object) -> Content:
    """A section from its template, which sees its tables and pictures as ``tables`` and ``pictures``."""
    tables = [each for each in exhibits if isinstance(each, ShownTable)]
    pictures = [each for each in exhibits if isinstance(each, Picture)]
    html = render_fragment(template, tables={each.name: each for each in tables}, pictures=pictures, **values)
    return Content(html, tables, pictures)


def _table(name: str, title: str, table: Table | None, corner: str, wide: bool = False) -> ShownTable | None:
    return None if table is None else ShownTable(name, title, table, corner, wide)


def _picture(name: str, title: str, caption: str, figure: Figure | None) -> Picture | None:
    return None if figure is None else Picture(name, title, caption, figure)


def paper_table_section(data: ReportData) -> Content:
    """The paper's table with our results in it."""
    table = cell_tables.paper_table(data.summary, data.published, data.planner)
    title = "Mean costs and improvements by home size and team size"
    shown = _table("paper", title, table, "planner", wide=True)
    return _content("paper_table", shown, marks=MARKS, known=known_sentence(data.rows))


def variants_section(data: ReportData) -> Content | None:
    """The variants of a sweep side by side, and each one's own answer."""
    if len(data.summaries) < 2:
        return None
    found = _variant_findings(data)
    curves = search_curves.sample_curves(data.episodes, data.planner)
    side_by_side = cell_tables.variant_table(data.summaries, data.planner)
    return _content(
        "variants",
        _table("variants", "The variants of the sweep", side_by_side, "variant"),
        *(shown for _, shown in found.values()),
        _picture(
            "samples",
            "Cost against samples",
            "Above: mean cost with 95 % bootstrap intervals, which show how much trials differ. Below: the same trials "
            "paired, so a band that excludes zero has more to gain from samples; cut off at 100 %. Dashed: planners "
            "that take no samples.",
            search_curves.draw_sample_curves(curves) if curves else None,
        ),
        _picture(
            "variants",
            "Improvement by variant",
            "All team sizes together, 95 % paired bootstrap intervals.",
            overview_charts.sweep(data.summaries, data.planner, BASELINES) if data.planner else None,
        ),
        findings=found,
    )


def _variant_findings(data: ReportData) -> dict[str, tuple[Findings, ShownTable]]:
    """Each variant's own answer and paper table."""
    found = {}
    for number, (variant, summary) in enumerate(data.summaries.items(), 1):
        planner = data.planner if data.planner in summary.planners else main_planner(summary.planners)
        table = cell_tables.paper_table(summary, data.published, planner)
        title = f"Mean costs and improvements: {variant or 'as configured'}"
        shown = ShownTable(f"paper-variant-{number}", title, table, "planner", wide=True)
        found[variant] = (find(summary, data.published, planner), shown)
    return found


def figures_section(data: ReportData) -> Content:
    """The charts."""
    rows, summary, published, planner = data.rows, data.summary, data.published, data.planner
    return _content(
        "figures",
        _picture(
            "improvement",
            "Improvement by home size and team size",
            "Share of the baseline's mean cost that is saved, with 95 % paired bootstrap intervals. "
            f"{known_sentence(data.rows) or ''}".strip(),
            overview_charts.improvements(summary, published, planner, BASELINES) if planner else None,
        ),
        _picture(
            "mean-cost",
            "Mean cost by team size",
            "95 % bootstrap intervals. Published means (dotted, hollow) are on the paper's own homes and tasks: "
            "compare improvements rather than costs.",
            overview_charts.mean_costs(summary, published),
        ),
        _picture(
            "scatter",
            "Planner against baseline, trial by trial",
            "One point per trial that both finished. In the shaded half, below the line, the planner is cheaper.",
            overview_charts.scatter(rows, summary, planner, BASELINES) if planner else None,
        ),
        _picture(
            "planning-time",
            "Planning time per decision",
            "Median and quartiles over episodes; whiskers from the 5th to the 95th percentile.",
            overview_charts.planning_times(rows, summary.planners),
        ),
        _picture(
            "team-size",
            "Cost and planning time by team size",
            f"All size classes together; bands are 95 % bootstrap intervals. {_where_search_helps(data)}".strip(),
            search_curves.by_team(rows, planner) if planner else None,
        ),
    )


def _where_search_helps(data: ReportData) -> str:
    found = search_curves.worth_by_team(data.rows, data.planner, RULE) if data.planner else None
    if data.planner is None or found is None:
        return ""
    teams = {"clearly sooner": found.clear, "not clearly sooner": found.unclear}
    parts = [f"{how} with {', '.join(map(str, sizes))}" for how, sizes in teams.items() if sizes]
    return f"Against {RULE}, {planner_label(data.planner)} is {' robots, '.join(parts)} robots."


def templates_section(data: ReportData) -> Content | None:
    """Each form of task by itself; None where the rows name no templates."""
    results = results_by_template(data.rows, data.planner)
    if data.planner is None or results is None:
        return None
    name = planner_label(data.planner)
    caption = f"Of {name} over each of the others, all cells together, with 95 % paired bootstrap intervals."
    return _content(
        "templates",
        _picture("templates", "Improvement by template", caption, draw_templates(results, data.planner)),
        _table("templates", f"{name} by template", template_table(results, data.planner), "template"),
    )


def wins_section(data: ReportData) -> Content | None:
    """How often the planner is sooner than each other; None where it is compared with none."""
    pairs = pair_table(data.summary, data.planner)
    if data.planner is None or pairs is None:
        return None
    name = planner_label(data.planner)
    caption = (
        f"Share of the trials that both finished in which {name} was sooner (left), equally fast (middle), or later "
        "(right) than the planner named above the panel."
    )
    return _content(
        "wins",
        _picture("wins", "Wins, ties and losses", caption, draw_wins(data.summary, data.planner)),
        _table("wins", f"{name} against each of the others, cell by cell", pairs, "cell"),
        planner=name,
        significant=SIGNIFICANT_P,
    )


def distribution_section(data: ReportData) -> Content | None:
    """The whole distribution of costs; None where nothing was finished."""
    ratios = cost_profiles.cost_ratios(data.rows)
    costs = cost_profiles.draw_costs(data.rows, data.summary)
    if ratios is None and costs is None:
        return None
    title = "The share of trials in which each planner is the cheapest, or nearly"
    return _content(
        "distribution",
        _picture(
            "profile",
            "Performance profile",
            "The share of trials that a planner finishes within a factor of the cheapest planner of the same trial "
            "(Dolan and Moré, 2002): at 1 how often it is the cheapest, further right how seldom it is far off. Higher "
            "is better.",
            cost_profiles.draw_profile(ratios) if ratios else None,
        ),
        _picture(
            "distribution",
            "Cost distribution",
            "The share of a cell's trials finished at no more than this cost. A curve further left is better. Each "
            "axis ends at the 99th percentile of its panel: trials missing there cost more, or failed.",
            costs,
        ),
        _table("profile", title, cost_profiles.profile_table(ratios), "planner"),
        trials=len(ratios.ratios) if ratios else 0,
    )


def trajectories_section(data: ReportData) -> Content | None:
    """Some episodes, drawn; None where there are no traces or homes."""
    if data.planner is None or "trace" not in data.rows.columns:
        return None
    names = compared_planners(data.rows, data.planner)
    beside = names[1] if len(names) > 1 else None
    pictures = []
    for number, pick in enumerate(instructive_trials(data.rows, data.planner, beside, data.homes.keys()), 1):
        rows = data.rows[data.rows["trial_id"] == pick.trial_id].to_dict("records")
        trial = {row["planner"]: row for row in rows}
        own = trial[data.planner]
        title = f"{pick.reason[0].upper()}{pick.reason[1:]}: trial {pick.trial_id}, {counted(own['robots'], 'robot')}"
        task = f"Task: {own['formula']}. " if "formula" in own else ""
        figure = draw_trial(data.homes[pick.home_id], {name: trial[name] for name in names}, data.called)
        pictures.append(Picture(f"trajectory-{number}", title, f"{task}Home {pick.home_id}.", figure))
    return _content("trajectories", *pictures) if pictures else None


def trials_section(data: ReportData) -> Content | None:
    """Every trial as a point that leads to it, and the trials worth a look; None without episodes."""
    browser = browse_trials(data.rows, data.planner, data.homes, data.replays)
    if browser is None:
        return None
    return _content(
        "trials",
        _table("notable", "Trials worth a look", _notable_table(data, browser), "trial"),
        browser=browser,
        replays=data.replays,
        place=place,
        plot={"size": PLOT_SIZE, "left": PLOT_LEFT, "bottom": PLOT_SIZE - PLOT_BOTTOM, "pad": PLOT_PAD},
        output_dir=data.manifest.get("output_dir"),
        robot_colors=[robot_color(team - 1) for team in browser.robots],
    )


def planners_section(data: ReportData) -> Content:
    """All planners over all episodes."""
    table = planner_table(data.summary, data.published)
    shown = _table("planners", "All planners over all episodes", table, "planner")
    return _content("planners", shown, known=known_sentence(data.rows))


def optimality_section(data: ReportData) -> Content | None:
    """How far planners are from the best that any planner can reach; None where it was not measured."""
    if not data.optimality:
        return None
    table = cell_tables.optimality_table(data.optimality)
    return _content("optimality", _table("optimality", "How far planners are from optimal", table, "cell"))


def gap_section(data: ReportData) -> Content | None:
    """The parts of the gap between planners and knowing everything; None where the planners this needs did not run."""
    ladder = gap.find_ladder(data.manifest, data.summary.planners)
    if ladder is None or not (gaps := gap.gaps_of(data.rows, data.summary, ladder, data.optimality)):
        return None
    title = "What the gap is made of"
    caption = "Mean cost above known, by part; the stroke marks the whole, which parts below zero reduce."
    return _content(
        "gap",
        _picture("gap", title, caption, gap.draw_gaps(gaps)),
        _table("gap", title, gap.gap_table(gaps), "planner", wide=True),
        truth=planner_label(ladder.truth),
        model=planner_label(ladder.model),
        counted=data.manifest.get("true_likelihoods") == "counted",
        certified=any(one.certified for one in gaps),
        known=known_sentence(data.rows),
        sentences=gap.gap_sentences(gaps),
    )


def model_section(data: ReportData) -> Content:
    """The likelihood model, and how good it is."""
    title = "The likelihood model on homes held back from training"
    return _content(
        "model",
        _table("model", title, run_facts.metric_table(data.manifest), "metric"),
        _picture(
            "reliability",
            "How often objects were where the model said, in the homes of this run",
            "Pairs of a container and an object, by the probability that planners were given before any search. On the "
            "line, probabilities are right; below it, the model is too sure. Bars are 95 % intervals over homes.",
            draw_reliability(data.manifest.get("reliability") or ()),
        ),
        facts=run_facts.model_facts(data.manifest, data.episodes),
        warning=run_facts.model_warning(data.manifest),
        rivals=" and ".join(str(rival["kind"]) for rival in data.manifest.get("rivals") or ()),
    )


def homes_section(data: ReportData) -> Content:
    """Where the homes come from."""
    return _content("homes", facts=run_facts.homes_facts(data.manifest, data.episodes))


def run_section(data: ReportData) -> Content:
    """How the run was made, and which episodes have no result."""
    return _content(
        "run",
        _table("failures", "Episodes without a result", run_facts.failure_table(data.episodes), "reason"),
        facts=run_facts.run_facts(data.manifest, data.episodes),
        episodes=len(data.episodes),
        config=run_facts.config_text(data.manifest),
    )


def method_section(data: ReportData) -> Content:
    """How the numbers are computed, and where the published ones come from."""
    title = "The paper's trials in real apartments"
    homes = homes_of(data.rows)
    return _content(
        "method",
        _table("real-world", title, cell_tables.real_world_table(data.published), "trial"),
        planners=describe_planners(data),
        model=model_sentence(part(data.manifest, "model")),
        known=known_sentence(data.rows),
        homes=homes_sentence(data.summary, data.published),
        resamples=RESAMPLES,
        trials=len(homes),
        home_count=homes.nunique(),
        repeated=home_repeats(homes),
        least_for_interval=MIN_TRIALS_FOR_INTERVAL,
        significant=SIGNIFICANT_P,
        citation=data.published.citation,
        citation_url=data.published.url,
    )


def papers_section(data: ReportData) -> Content:
    """Further text for a paper on this run: a methods paragraph, and citations."""
    sentences = methods_sentences(data)
    code_version = data.manifest.get("code_version")
    entries = bibtex(data.published, str(code_version) if code_version else None)
    files = {
        "methods.tex": methods_latex(sentences),
        "methods.md": methods_markdown(sentences),
        "references.bib": entries,
    }
    html = render_fragment("papers", methods=" ".join(sentences), bibtex=entries, files=tuple(files))
    return Content(html, files=files)


def claims_section(data: ReportData) -> Content | None:
    """Each claim of the paper with a verdict and where to see it; None where robots differ: the paper's do not."""
    if without_cells(data.rows):
        return None
    claims = judge_claims(data)
    content = _content(
        "claims",
        _table("claims", "The paper's claims, judged on this run", claims_table(claims, data.judged), "claim"),
        claims=claims,
        protocols=[protocol(data, name) for name in data.judged],
    )
    counts = "; ".join(f"{protocol(data, name)}: {count_verdicts(claims, name)}" for name in data.judged)
    return replace(content, in_short=f"{counts}.")


SECTIONS: Sequence[Section] = (
    Section("table", "Table", "The paper's table", paper_table_section),
    Section("variants", "Variants", "The sweep's variants", variants_section),
    Section("figures", "Figures", "Figures", figures_section),
    Section("templates", "Templates", "By template", templates_section),
    Section("wins", "Wins", "Wins, ties, losses", wins_section),
    Section("distribution", "Distribution", "Distribution of costs", distribution_section),
    Section("trajectories", "Trajectories", "Trajectories", trajectories_section),
    Section("trials", "Trials", "Trial by trial", trials_section),
    Section("planners", "Planners", "All planners, all episodes", planners_section),
    Section("optimality", "Optimality", "How far from optimal", optimality_section),
    Section("gap", "Gap", "What the gap is made of", gap_section),
    Section("model", "Likelihood model", "Likelihood model", model_section),
    Section("homes", "Homes", "Homes", homes_section),
    Section("run", "Run", "Run", run_section),
    Section("method", "Method", "Method", method_section),
    Section("papers", "For papers", "For papers", papers_section),
    Section("claims", "Checklist", "Checklist of the reproduction", claims_section),
)
"""In the order of the page."""


def _notable_table(data: ReportData, browser: TrialBrowser) -> Table | None:
    """Why each trial is worth a look, its task, and its outcome with the planner and the baseline."""
    rows = [
        Row(
            pick.trial_id,
            (
                Entry(pick.reason, tone="text"),
                Entry(_task(data.rows, pick.trial_id), tone="text"),
                *map(Entry, _outcomes(data.rows, pick.trial_id, browser)),
            ),
        )
        for pick in data.picks
    ]
    headings = ("why", "task", *map(planner_label, browser.compared))
    return Table(tuple(("", name) for name in headings), tuple(rows)) if rows else None


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
    """A trial's outcome with the planner and the baseline: seconds, or the status."""
    of_trial = rows[rows["trial_id"] == trial_id].to_dict("records")
    found = {
        row["planner"]: f"{row['cost_s']:.1f} s" if row["status"] == "accepted" else row["status"] for row in of_trial
    }
    return [found.get(name, NOTHING) for name in browser.compared]
