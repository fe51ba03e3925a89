"""What the report says beside the results: the likelihood model, the homes, the run, and what went wrong in it.

A manifest is the JSON that a run writes; every key is optional, and missing ones are not shown.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mrtask.analysis.page.style import NOTHING, planner_label, seconds
from mrtask.analysis.page.tables import Entry, Row, Table
from mrtask.analysis.results.manifest import Manifest, part

Fact = tuple[str, str]

METRICS = {
    "log_loss": ("log loss", "lower"),
    "best_log_loss": ("log loss that no model of names can beat", ""),
    "roc_auc": ("ROC AUC", "higher"),
    "average_precision": ("average precision", "higher"),
    "brier": ("Brier score", "lower"),
    "ece": ("expected calibration error", "lower"),
}
"""Metric -> name and whether a higher or a lower value is better, in the order shown."""
DECIDING = ("log_loss", "roc_auc")
"""The first of these that both models have decides which model is better."""
ABSOLUTE_PATH = re.compile(r"""(?:(?<![\w/.~:<-])|(?<=sqlite:///)|(?<=file://))(?:/[^\s/,;:'"<>()\[\]]+){2,}""")
"""At least two folders deep; neither part of a web address nor of a relative path."""
MAX_REASONS = 25
MAX_REASON_CHARS = 240
FAILURE_COLUMNS = tuple(("", name) for name in ("status", "episodes", "trials", "planners", "first trial"))


def without_folders(value: Any, base: Path) -> Any:
    """``value`` with every absolute path in its texts cut to what lies below ``base``, or else to its last part.

    Absolute paths name people and machines, which a report for blind review must not.
    """
    if isinstance(value, str):
        return ABSOLUTE_PATH.sub(lambda path: _short(path[0], base), value)
    if isinstance(value, Mapping):
        return {key: without_folders(each, base) for key, each in value.items()}
    return [without_folders(each, base) for each in value] if isinstance(value, list | tuple) else value


def _short(path: str, base: Path) -> str:
    inside = Path(path).is_relative_to(base) and Path(path) != base
    return str(Path(path).relative_to(base)) if inside else f".../{Path(path).name}"


def model_facts(manifest: Manifest, episodes: pd.DataFrame) -> tuple[Fact, ...]:
    """Facts on the likelihood model that the planners used."""
    model = part(manifest, "model")
    version = model.get("version")
    if version is None and "model_version" in episodes.columns:
        version = ", ".join(sorted(episodes["model_version"].dropna().astype(str).unique())) or None
    listed = [
        ("name", model.get("name")),
        ("version", version),
        ("champion", _champion(model, version)),
        ("kind", model.get("kind")),
        ("embedding", model.get("embedding")),
        ("training homes", model.get("training_homes")),
        ("held-back homes of the metrics", model.get("test_homes")),
        ("run", model.get("run_id")),
        ("note", model.get("note")),
    ]
    return _shown(listed)


def _champion(model: Manifest, version: str | None) -> str | None:
    """Whether the version that planned was the champion, and if not which was."""
    champion = model.get("champion_version")
    if champion is None or version is None:
        promoted = model.get("champion")
        return None if promoted is None else "yes" if promoted else "no"
    return "yes" if champion == version else f"no, the champion was version {champion}; this run did not plan with it"


def beats_frequency(manifest: Manifest) -> bool | None:
    """Whether the model is better than the frequency table on held-back homes; None where that is unknown."""
    stated = part(manifest, "model").get("beats_frequency")
    if isinstance(stated, bool):
        return stated
    for metric in DECIDING:
        own, frequency = _metric(manifest, metric)
        if own is not None and frequency is not None:
            return own < frequency if METRICS[metric][1] == "lower" else own > frequency
    return None


def model_warning(manifest: Manifest) -> str | None:
    """A warning where the model is no better than a frequency table."""
    if beats_frequency(manifest) is not False:
        return None
    values = {METRICS[metric][0]: _metric(manifest, metric) for metric in DECIDING}
    shown = [
        f"{name} {own:.4f} against {other:.4f}"
        for name, (own, other) in values.items()
        if own is not None and other is not None
    ]
    figures = f" ({', '.join(shown)})" if shown else ""
    return f"The likelihood model does not beat the frequency table on held-back homes{figures}."


def metric_table(manifest: Manifest) -> Table | None:
    """The metrics of the model that planned, of those trained beside it and the frequency table; None without any."""
    model, rivals = part(manifest, "model"), manifest.get("rivals") or ()
    shown = {f"this model, {model['kind']}" if model.get("kind") else "this model": part(model, "metrics")}
    shown |= {f"{rival['kind']}, version {rival['version']}": part(rival, "metrics") for rival in rivals}
    shown |= {"frequency table": part(model, "frequency_metrics")}
    rows = []
    for metric, (name, better) in METRICS.items():
        values = [_number(metrics.get(metric)) for metrics in shown.values()]
        if any(value is not None for value in values):
            entries = tuple(Entry(NOTHING if value is None else f"{value:.4f}") for value in values)
            rows.append(Row(f"{name} ({better} is better)" if better else name, entries))
    return Table(tuple(("", name) for name in shown), tuple(rows)) if rows else None


def _metric(manifest: Manifest, metric: str) -> tuple[float | None, float | None]:
    """The value of the model and that of the frequency table."""
    model = part(manifest, "model")
    return _number(part(model, "metrics").get(metric)), _number(part(model, "frequency_metrics").get(metric))


def homes_facts(manifest: Manifest, episodes: pd.DataFrame) -> tuple[Fact, ...]:
    """Facts on the homes: where they come from, how many, how much of them robots reach."""
    homes = part(manifest, "homes")
    share = _number(homes.get("reachable_share"))
    ran = episodes["home_id"].nunique() if "home_id" in episodes.columns else None
    listed = [
        ("source", homes.get("source")),
        ("files", _text(homes.get("files"))),
        ("read", homes.get("read")),
        ("training", homes.get("training")),
        ("for evaluation", homes.get("evaluated")),
        ("for evaluation, by size class", _text(homes.get("by_size_class"))),
        ("in the episodes", ran),
        ("containers", homes.get("containers")),
        ("containers that a robot can reach", None if share is None else f"{100 * share:.2f} %"),
        ("skipped", _text(homes.get("skipped"))),
    ]
    return _shown(listed)


def run_facts(manifest: Manifest, episodes: pd.DataFrame) -> tuple[Fact, ...]:
    """Facts on the run: command, versions, seed, time."""
    stages = {name: seconds(s) for name, value in part(manifest, "stages").items() if (s := _number(value)) is not None}
    wall_s, peak_mb = _number(manifest.get("wall_s")), _number(manifest.get("peak_memory_mb"))
    listed = [
        ("experiment", manifest.get("experiment")),
        ("command", manifest.get("command")),
        ("started", manifest.get("started")),
        ("wall time", None if wall_s is None else seconds(wall_s)),
        ("grown, request by request", "; then ".join(manifest.get("grown") or ())),
        ("stages", _text(stages)),
        ("seed", manifest.get("seed")),
        ("planners", _text(manifest.get("planners"))),
        ("planner options", _text(manifest.get("planner_options"))),
        ("configuration", _from_rows(manifest, episodes, "config_hash")),
        ("code version", _from_rows(manifest, episodes, "code_version")),
        ("machine", _text(manifest.get("machine"))),
        ("peak memory", None if peak_mb is None else f"{peak_mb:,.0f} MB"),
        ("output", manifest.get("output_dir")),
    ]
    return _shown(listed)


def missing_episodes(manifest: Manifest, episodes: pd.DataFrame) -> str | None:
    """A warning where the run has fewer episodes than were planned."""
    expected = _number(manifest.get("expected_episodes"))
    if expected is None or len(episodes) >= expected:
        return None
    return f"{int(expected) - len(episodes)} of {int(expected)} episodes are missing: the evaluation has not finished."


def failure_table(episodes: pd.DataFrame) -> Table | None:
    """Episodes without a result by status and reason, most frequent first; None where all were accepted."""
    rows = episodes[episodes["status"] != "accepted"]
    if rows.empty:
        return None
    reasons = rows["error"].map(reason_of) if "error" in rows.columns else pd.Series("", index=rows.index)
    grouped = rows.assign(reason=reasons).groupby(["status", "reason"])
    found = sorted(grouped, key=lambda failure: (-len(failure[1]), failure[0]))
    lines = [
        Row(
            str(reason) or "no reason given",
            (
                Entry(str(status)),
                Entry(str(len(group))),
                Entry(str(group["trial_id"].nunique())),
                Entry(", ".join(map(planner_label, sorted(set(group["planner"])))), tone="text"),
                Entry(min(group["trial_id"])),
            ),
        )
        for (status, reason), group in found[:MAX_REASONS]
    ]
    if others := found[MAX_REASONS:]:
        entries = (Entry(NOTHING), Entry(str(sum(len(group) for _, group in others))), *[Entry(NOTHING)] * 3)
        lines.append(Row(f"{len(others)} other reasons", entries))
    return Table(FAILURE_COLUMNS, tuple(lines))


def config_text(manifest: Manifest) -> str | None:
    """The configuration as indented JSON."""
    config = part(manifest, "config")
    return json.dumps(config, indent=2, default=str, ensure_ascii=False) if config else None


def _shown(listed: Sequence[tuple[str, object]]) -> tuple[Fact, ...]:
    return tuple((name, str(value)) for name, value in listed if value is not None and value != "")


def _from_rows(manifest: Manifest, episodes: pd.DataFrame, column: str) -> object:
    if manifest.get(column) is not None or column not in episodes.columns:
        return manifest.get(column)
    return ", ".join(sorted(episodes[column].dropna().astype(str).unique()))


def _text(value: object) -> str | None:
    """Lists as ``a, b``, mappings as ``a: 1, b: 2``."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_nested(each)}" for key, each in value.items() if each not in (None, {}, []))
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return None if value is None else str(value)


def _nested(value: object) -> str | None:
    return f"({_text(value)})" if isinstance(value, Mapping) else _text(value)


def reason_of(error: object) -> str:
    """The first line of an error; of a traceback, the last, which names the exception."""
    if not isinstance(error, str) or not error.strip():
        return ""
    lines = error.strip().splitlines()
    line = lines[-1] if lines[0].startswith("Traceback") else lines[0]
    return line if len(line) <= MAX_REASON_CHARS else line[: MAX_REASON_CHARS - 3] + "..."


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
