"""The report: one ``index.html`` that holds everything it shows and needs no network, and ``table.csv`` beside it.

It opens with the answer, in words computed from the data, and goes on to the table, figures, drawn episodes and the
facts of model, homes and run.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from matplotlib.figure import Figure

from mrtask.analysis import curves, facts, figures, tables
from mrtask.analysis.episodes import Variant, checked_episodes, variants_in_order
from mrtask.analysis.findings import Findings, find, main_planner, mixture_warnings
from mrtask.analysis.published import load_published
from mrtask.analysis.statistics import BASELINES, INFORMED_BASELINE, MIN_TRIALS_FOR_INTERVAL, RESAMPLES, Summary, summarise
from mrtask.analysis.style import data_uri, planner_label
from mrtask.analysis.trajectories import Pick, draw_trial, instructive_trials
from mrtask.homes.home import Home

RULE = "greedy"
"""The strongest planner without search: what search is worth is its improvement over this one."""
TEMPLATE = "report.html.jinja"
REPORT_FILE, TABLE_FILE = "index.html", "table.csv"


@dataclass(frozen=True)
class Picture:
    """An embedded figure with its caption, which is its text for those who cannot see it too."""

    uri: str
    title: str
    caption: str


def render_report(
    episodes: pd.DataFrame, manifest: Mapping[str, Any], homes: Mapping[str, Home], out_dir: Path
) -> Path:
    """Writes ``index.html`` and ``table.csv`` into ``out_dir``; an earlier report is replaced only by a whole new one.

    Args:
        episodes: one row per (trial, planner); see `mrtask.analysis.episodes.REQUIRED_COLUMNS`. A ``sweep`` column
            tells a sweep's variants apart.
        manifest: what the run left as JSON: ``experiment, seed, planners, model {...}, homes {...}, wall_s, config,
            ...``; `mrtask.analysis.facts` reads it, and all of it is optional.
        homes: home id -> home, for drawing; homes that are missing are not drawn. `trials_to_draw` says which serve.

    Returns:
        The path of ``index.html``.

    Raises:
        ValueError: the episodes are not what they should be; nothing is written then.
    """
    frame = checked_episodes(episodes)
    published = load_published()
    variants = variants_in_order(frame) or [""]
    summaries = {variant: summarise(frame[frame["variant"] == variant]) for variant in variants}
    shown = variants[-1]
    rows, summary = frame[frame["variant"] == shown], summaries[shown]
    planner = _main_planner(summary, manifest)
    findings = find(summary, published, planner)
    model = facts.model_facts(manifest, frame)
    warnings = [*findings.warnings, *mixture_warnings(rows)]
    warnings += [text for text in (facts.missing_episodes(manifest, frame), model.warning) if text]
    context = {
        "title": f"mrtask: experiment {manifest['experiment']}" if manifest.get("experiment") else "mrtask: report",
        "question": _question(planner),
        "findings": findings,
        "warnings": warnings,
        "planner": planner_label(planner) if planner else None,
        "shown": shown,
        "variants": variants if len(variants) > 1 else [],
        "variant_table": tables.variant_table(summaries, planner),
        "variant_findings": _other_findings(summaries, planner) if len(variants) > 1 else {},
        "variant_picture": _picture(
            figures.sweep(summaries, planner, BASELINES) if planner else None,
            "Improvement by variant",
            "All team sizes together, 95 % paired bootstrap intervals.",
        ),
        "samples_picture": _picture(
            curves.by_samples(frame, planner),
            "Cost against samples",
            "Above: mean cost with 95 % bootstrap intervals, which say how much trials differ. Below: the same trials "
            "paired, so a band that excludes zero has more to gain from samples; cut off at 100 %. Dashed: planners "
            "that take no samples.",
        ),
        "paper_table": tables.paper_table(summary, published, planner),
        "planner_table": tables.planner_table(summary),
        "pair_table": tables.pair_table(summary, planner),
        "real_world_table": tables.real_world_table(published),
        "marks": {"above": tables.ABOVE, "below": tables.BELOW, "level": tables.LEVEL},
        "pictures": _charts(rows, summary, planner),
        "trajectories": _trajectories(rows, homes, planner),
        "model": model,
        "homes_facts": facts.homes_facts(manifest, frame),
        "run_facts": facts.run_facts(manifest, frame),
        "failures": facts.failure_table(frame),
        "config": facts.config_text(manifest),
        "citation": published.citation,
        "citation_url": published.url,
        "episodes": len(frame),
        "resamples": RESAMPLES,
        "least_for_interval": MIN_TRIALS_FOR_INTERVAL,
    }
    source = resources.files(__package__).joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.from_string(source).render(context)
    table = tables.result_table(summaries, published).to_csv(index=False, float_format="%.6g", lineterminator="\n")
    out_dir.mkdir(parents=True, exist_ok=True)
    _write_whole(out_dir / TABLE_FILE, table)
    return _write_whole(out_dir / REPORT_FILE, page)


def trials_to_draw(episodes: pd.DataFrame, manifest: Mapping[str, Any]) -> list[Pick]:
    """The trials that the report of these episodes draws, so that no other home or trace needs loading."""
    frame = checked_episodes(episodes)
    rows = frame[frame["variant"] == (variants_in_order(frame) or [""])[-1]]
    planner = main_planner(tuple(rows["planner"].unique()), manifest.get("main_planner"))
    if planner is None:
        return []
    return instructive_trials(rows, planner, _drawn_baseline(rows, planner))


def _main_planner(summary: Summary, manifest: Mapping[str, Any]) -> str | None:
    return main_planner(summary.planners, manifest.get("main_planner"))


def _question(planner: str | None) -> str:
    who = f"the planner {planner_label(planner)}" if planner else "the learning-informed planner"
    return f"Does {who} beat the baselines, by how much, and how does that compare with the published results?"


def _other_findings(summaries: Mapping[Variant, Summary], planner: str | None) -> dict[Variant, tuple[Findings, Any]]:
    """Each variant's own answer and paper table, for those that are not shown in full."""
    published = load_published()
    found = {}
    for variant, summary in summaries.items():
        own = planner if planner in summary.planners else main_planner(summary.planners)
        found[variant] = (find(summary, published, own), tables.paper_table(summary, published, own))
    return found


def _charts(rows: pd.DataFrame, summary: Summary, planner: str | None) -> list[Picture]:
    published = load_published()
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
            f"All size classes together, bands are 95 % bootstrap intervals. {_where_search_helps(rows, planner)}",
        ),
    ]
    return [picture for picture in drawn if picture]


def _where_search_helps(rows: pd.DataFrame, planner: str | None) -> str:
    found = curves.worth_by_team(rows, planner, RULE) if planner else None
    if found is None:
        return ""
    told = [
        f"{how} with {', '.join(map(str, teams))}"
        for how, teams in (("clearly sooner", found.clear), ("not clearly sooner", found.unclear))
        if teams
    ]
    return f"Against {RULE}, {planner_label(planner or '')} is {' robots, '.join(told)} robots."


def _trajectories(rows: pd.DataFrame, homes: Mapping[str, Home], planner: str | None) -> list[Picture]:
    if planner is None or "trace" not in rows.columns:
        return []
    baseline = _drawn_baseline(rows, planner)
    names = [planner] if baseline is None else [planner, baseline]
    pictures = []
    for pick in instructive_trials(rows, planner, baseline, homes.keys()):
        trial = {row["planner"]: row for row in rows[rows["trial_id"] == pick.trial_id].to_dict("records")}
        task = f"Task: {trial[planner]['formula']}." if "formula" in rows.columns else ""
        robots = trial[planner]["robots"]
        team = "1 robot" if robots == 1 else f"{robots} robots"
        figure = draw_trial(homes[pick.home_id], {name: trial[name] for name in names})
        title = f"{pick.reason[0].upper()}{pick.reason[1:]}: trial {pick.trial_id}, {team}"
        picture = _picture(figure, title, f"{task} Home {pick.home_id}.".strip())
        pictures += [picture] if picture else []
    return pictures


def _drawn_baseline(rows: pd.DataFrame, planner: str) -> str | None:
    """The planner drawn beside the main one: the informed baseline, or the first other there is."""
    others = [name for name in (INFORMED_BASELINE, *BASELINES, *sorted(rows["planner"].unique())) if name != planner]
    return next((name for name in others if (rows["planner"] == name).any()), None)


def _picture(figure: Figure | None, title: str, caption: str) -> Picture | None:
    return Picture(data_uri(figure), title, caption) if figure is not None else None


def _write_whole(path: Path, text: str) -> Path:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path
