"""Text for papers that use a run: a methods paragraph with the run's numbers and versions, and citations."""

from collections.abc import Sequence
from importlib.metadata import version

import pandas as pd

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report.by_template import templates_in_order
from mrtask.analysis.report.for_papers import latex_text, markdown_text
from mrtask.analysis.report.planner_words import known_sentence
from mrtask.analysis.report.report_data import ReportData
from mrtask.analysis.results.episodes import size_classes_in_order
from mrtask.analysis.results.manifest import Manifest, part
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.statistics import RESAMPLES, home_repeats, homes_of
from mrtask.names import counted, listed

SOFTWARE_TITLE = "mrtask: multi-robot task planning in homes where nobody knows which object lies where"
SOFTWARE_AUTHORS = "The mrtask authors"
SOFTWARE_YEAR = 2026
PAPER_KEY, SOFTWARE_KEY = "khanal2026multirobot", "mrtask"


def methods_sentences(data: ReportData) -> list[str]:
    """The paragraph, sentence by sentence, without what the run did not record."""
    return [
        _trials_sentence(data.rows, part(data.manifest, "homes")),
        *_task_sentences(data.rows, part(part(data.manifest, "config"), "evaluation")),
        *_team_sentences(part(part(data.manifest, "config"), "team")),
        *_planner_sentences(data),
        *_model_sentences(part(data.manifest, "model")),
        *_outcome_sentences(data.rows),
        *_machine_sentences(data.rows),
        *_software_sentences(data.manifest),
    ]


def methods_markdown(sentences: Sequence[str]) -> str:
    """The paragraph as a file."""
    return markdown_text(" ".join(sentences)) + "\n"


def methods_latex(sentences: Sequence[str]) -> str:
    r"""The paragraph as a file that cites `bibtex`'s entries."""
    return "\n".join(map(latex_text, sentences)) + f"\n\\cite{{{PAPER_KEY},{SOFTWARE_KEY}}}\n"


def bibtex(published: Published, code_version: str | None) -> str:
    """The entries of the paper whose experiment this is, and of this software with the code's version."""
    note = f"  note = {{code {latex_text(code_version)}}},\n" if code_version else ""
    return (
        f"@inproceedings{{{PAPER_KEY},\n"
        f"  author = {{{' and '.join(published.authors)}}},\n"
        f"  title = {{{{{published.title}}}}},\n"
        f"  booktitle = {{{published.booktitle}}},\n"
        f"  year = {{{published.year}}},\n"
        f"  eprint = {{{published.arxiv}}},\n"
        "  archivePrefix = {arXiv},\n"
        "}\n\n"
        f"@software{{{SOFTWARE_KEY},\n"
        f"  author = {{{{{SOFTWARE_AUTHORS}}}}},\n"
        f"  title = {{{{{SOFTWARE_TITLE}}}}},\n"
        f"  version = {{{version('mrtask')}}},\n"
        f"  year = {{{SOFTWARE_YEAR}}},\n"
        f"{note}"
        "}\n"
    )


def _trials_sentence(rows: pd.DataFrame, homes: Manifest) -> str:
    trials = rows.drop_duplicates("trial_id")
    cells = trials.groupby(["size_class", "robots"]).size()
    if cells.empty:
        return "No episode was run."
    each = str(cells.iloc[0]) if cells.nunique() == 1 else f"{cells.min()} to {cells.max()}"
    classes, teams = size_classes_in_order(trials["size_class"].unique()), sorted(trials["robots"].unique())
    text = f"We ran {counted(len(trials), 'trial')}, {each} for each of {counted(len(cells), 'cell')}"
    text += f" of home size ({listed(classes)}) and team size ({listed(map(str, teams))})"
    if "home_id" in trials.columns and trials["home_id"].notna().any():
        source = f" ({homes['source']})" if homes.get("source") else ""
        text += f", in {counted(trials['home_id'].nunique(), 'home')}{source}"
    return f"{text}."


def _task_sentences(rows: pd.DataFrame, evaluation: Manifest) -> list[str]:
    sentences = ["All planners run the same trials: the same home, task, start and hidden contents."]
    if "template" in rows.columns and rows["template"].notna().any():
        names = templates_in_order(rows)
        forms = "form" if len(names) == 1 else "forms"
        sentences.append(f"Tasks are co-safe LTL formulas of the {forms} {listed(names)}.")
    keys = ("speed_m_per_s", "search_time_s", "interact_time_s")
    if all(isinstance(evaluation.get(key), int | float) for key in keys):
        speed, search, interact = (evaluation[key] for key in keys)
        sentences.append(
            f"Robots drive at {speed:g} m/s; a search takes {search:g} s and an interaction {interact:g} s."
        )
    return sentences


def _team_sentences(team: Manifest) -> list[str]:
    robots = team.get("robots") or ()
    if not robots:
        return []
    described = [
        f"{robot.get('name') or f'robot {number}'} ({', '.join(_said(robot)) or 'as all'})"
        for number, robot in enumerate(robots, 1)
    ]
    return [f"The team {team['name']}, of which a smaller team takes the first, is {listed(described)}."]


def _said(robot: Manifest) -> list[str]:
    """What sets a robot apart."""
    units = {
        "speed_m_per_s": "{:g} m/s",
        "search_time_s": "searches in {:g} s",
        "interact_time_s": "interacts in {:g} s",
        "radius_m": "radius {:g} m",
    }
    said = [text.format(robot[key]) for key, text in units.items() if robot.get(key) is not None]
    if (start := robot.get("start")) is not None:
        said.append(f"starts at ({start[0]:g}, {start[1]:g}) m")
    for key in ("handles", "opens"):
        if (names := robot.get(key)) is not None:
            said.append(f"{key} {listed(names) if names else 'nothing'}")
    return said


def _planner_sentences(data: ReportData) -> list[str]:
    if not data.summary.planners:
        return []
    options = part(data.manifest, "planner_options")
    samples = {name: part(options, name).get("samples") for name in data.summary.planners}
    named = [
        planner_label(name) + (f" (at most {count:,} samples)" if isinstance(count, int) else "")
        for name, count in samples.items()
    ]
    sentence = f"The {'planner is' if len(named) == 1 else 'planners are'} {listed(named)}; samples are per decision."
    return [text for text in (sentence, known_sentence(data.rows)) if text]


def _model_sentences(model: Manifest) -> list[str]:
    if not model:
        return []
    kind = f" of kind {model['kind']}" if model.get("kind") else ""
    number = f", version {model['version']}" if model.get("version") else ""
    homes = f", trained on {model['training_homes']} other homes" if model.get("training_homes") else ""
    return [f"The likelihood of an object in a container is from a model{kind}{number}{homes}."]


def _outcome_sentences(rows: pd.DataFrame) -> list[str]:
    if rows.empty:
        return []
    accepted = int((rows["status"] == "accepted").sum())
    return [
        f"All {len(rows):,} episodes finished their task."
        if accepted == len(rows)
        else f"Of {len(rows):,} episodes {accepted:,} finished their task; the others have no cost and are in no mean.",
        "An improvement is one minus the ratio of mean costs over the trials that both planners finished; intervals "
        f"are 95 % bias-corrected and accelerated bootstrap intervals from {RESAMPLES:,} paired resamples "
        f"of {_resampled(rows)}.",
    ]


def _machine_sentences(rows: pd.DataFrame) -> list[str]:
    """On how many machines it ran, and what ran again because a worker died; their names are nobody's business."""
    machines = rows["node"].nunique() if "node" in rows.columns else 0
    again = int((rows["attempt"] > 1).sum()) if "attempt" in rows.columns else 0
    sentences = [f"The episodes ran on {machines} machines."] if machines > 1 else []
    if again:
        have = "episode was" if again == 1 else "episodes were"
        sentences.append(f"{again:,} {have} sent to a worker more than once; that changes no result.")
    return sentences


def _resampled(rows: pd.DataFrame) -> str:
    homes = homes_of(rows)
    return f"homes, each with all of its trials ({homes.nunique()} homes)" if home_repeats(homes) else "trials"


def _software_sentences(manifest: Manifest) -> list[str]:
    named = [f"mrtask {version('mrtask')}" + (f" (code {code})" if (code := manifest.get("code_version")) else "")]
    python = part(manifest, "machine").get("python")
    named += [f"Python {python}"] if python else []
    named += [f"{name} {number}" for name, number in part(manifest, "packages").items()]
    seed = f"The seed is {manifest['seed']}; " if manifest.get("seed") is not None else ""
    return [f"{seed}{'the' if seed else 'The'} software is {listed(named)}."]
