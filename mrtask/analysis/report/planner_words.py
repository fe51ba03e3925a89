"""The planners of a run in words: two sentences for each, and where the paper's planner departs from the paper.

What depends on an option is read from the options that the run recorded, so a variant is described as it ran.
"""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report.report_data import ReportData
from mrtask.analysis.report.run_facts import Fact
from mrtask.analysis.results.manifest import Manifest, part
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.roles import BASELINES, KNOWN
from mrtask.analysis.results.statistics import Summary
from mrtask.names import counted, listed
from mrtask.planning.planners import PAPERS_PLANNER

Options = Mapping[str, Any]
PAPERS_MODEL = "paper_fcnn"
"""The kind of model with the paper's layers."""

DESCRIPTIONS = {
    "nonlearned_myopic": (
        "The paper's baseline without learning: robots go to the nearest unsearched containers, with the least summed "
        "way. It fetches a known object that advances the task before it searches on."
    ),
    "learned_myopic": (
        "The paper's baseline with learning: robots go to the containers that most likely hold an object still needed, "
        "again with the least summed way. It looks neither at distance nor ahead."
    ),
    "greedy": (
        "A rule without search: each robot takes the container with the least travel time per probability of advancing "
        "the task. It is also the roll-out of pouct."
    ),
    PAPERS_PLANNER: (
        "The paper's planner: PO-UCT over pairs of a container and an object, with the outcomes of the paper's "
        "Algorithm 1 and free robots assigned one after the other in the tree. {departures}"
    ),
    "pouct": (
        "Our planner: PO-UCT over containers, of which a search shows all objects, with hidden worlds drawn whole from "
        "the belief, greedy roll-outs and progressive widening. It takes the most visited joint action{redirects}."
    ),
    "known": (
        "A reference and no contestant: it is told where everything is, and shows what uncertainty costs. It follows a "
        "fastest run where that is computed exactly, and searches like pouct elsewhere."
    ),
}
OWN = "A planner of the user's own, {path}. Its options stand under Run."
LEAVES = {
    "revealed": "our own value of leaves (the mean time if the contents were revealed)",
    "greedy": "our own value of leaves (a greedy roll-out)",
    "zero": "leaves without a value (as the authors' development code has them)",
}


def describe_planners(data: ReportData) -> tuple[Fact, ...]:
    """Return each planner's name and description, with the samples that it drew."""
    facts = []
    for name in data.summary.planners:
        behind, options = _behind(data, name), part(part(data.manifest, "planner_options"), name)
        text = DESCRIPTIONS.get(behind, OWN).format(
            path=behind,
            departures=departures_sentence(options),
            redirects=", and may redirect robots under way" if options.get("reassign") == "all" else "",
        )
        facts.append((planner_label(name), f"{text}{_samples(data.rows, name, options)}"))
    return tuple(facts)


def protocol(data: ReportData, planner: str) -> str:
    """Return the planner's name; of the paper's, also what makes it another than the paper's text."""
    label = planner_label(planner)
    if _behind(data, planner) != PAPERS_PLANNER:
        return label
    found = departures(part(part(data.manifest, "planner_options"), planner))
    return f"{label} (the paper's text with {listed(found)})" if found else label


def departures_sentence(options: Options) -> str:
    """Return where these options of the paper's planner depart from the paper's text."""
    if not options:
        return "The run did not record its options."
    found = departures(options)
    if not found:
        return "Its options are a reading of the paper's text."
    return f"It is not the planner as the paper's text has it, but has {listed(found)}."


def departures(options: Options) -> list[str]:
    """Return what is not in the paper's text, each with where it comes from; see `PaperOptions`."""
    limit, decimals = options.get("max_actions"), options.get("round_decimals")
    found = [
        LEAVES.get(str(options.get("leaf")), ""),
        "our condition that every object is somewhere" if options.get("exists") else "",
        f"the authors' code's cut to the {limit} likeliest actions" if limit is not None else "",
        "the code's choice of the most visited action" if options.get("choice") == "visits" else "",
        "the code's targets avoided" if options.get("avoid_targets") else "",
        "the code's rule for a robot that acts alone" if options.get("advance_when_alone") else "",
        f"the code's probabilities of {decimals} decimals" if decimals is not None else "",
        "the code's redirecting of robots under way" if options.get("reassign") == "all" else "",
    ]
    return [text for text in found if text]


def model_sentence(model: Manifest) -> str | None:
    """Return which model the planners are given, and whether it is the paper's; None where the run recorded none."""
    kind = model.get("kind")
    if not kind:
        return None
    whose = "the paper's network" if kind == PAPERS_MODEL else f"not the paper's network, which is {PAPERS_MODEL} here"
    return f"All planners but known are given the likelihoods of the model {kind}: {whose}."


def known_sentence(rows: pd.DataFrame) -> str | None:
    """Return in how many episodes `known` was exact, and what it is elsewhere; None where it did not run.

    An episode without samples needed no search at any of its decisions.
    """
    own = rows[rows["planner"] == KNOWN]
    if own.empty:
        return None
    if "samples" not in own.columns:
        return f"The run did not record where {KNOWN} was searched; there it is a reference, not a bound."
    exact, total = int((own["samples"] == 0).sum()), counted(len(own), "episode")
    if exact == 0:
        return f"{KNOWN} was searched in all of its {total}: it is a reference here, not a bound."
    if exact == len(own):
        return f"{KNOWN} was solved exactly in all of its {total} (0 samples), so no planner can be faster."
    return (
        f"{KNOWN} was solved exactly in {exact} of its {total} (0 samples), where no planner can be faster; it is a "
        "reference, not a bound, in the others, where it was searched."
    )


def homes_sentence(summary: Summary, published: Published) -> str | None:
    """Return how the baselines' mean costs compare with the published ones; None where no cell has both."""
    shares: dict[str, list[float]] = {}
    for size_class, robots in summary.cells:
        for baseline in BASELINES:
            printed = published.cost_of(baseline, (size_class, robots))
            if printed and (cost := summary.cost((size_class, robots), baseline)).defined:
                shares.setdefault(size_class, []).append(100 * cost.value / printed)
    if not shares:
        return None
    parts = [f"{min(found):.0f} to {max(found):.0f} % in {name} homes" for name, found in shares.items()]
    return (
        f"Homes differ from the paper's, which are not published: the baselines' mean costs are {listed(parts)} of "
        "what the paper prints. So a comparison with published figures is one of improvements, and even that is "
        "between different homes and tasks."
    )


def _behind(data: ReportData, name: str) -> str:
    return str(part(data.manifest, "behind").get(name, name))


def _samples(rows: pd.DataFrame, planner: str, options: Options) -> str:
    """Return the most samples that a decision may take and the mean over all decisions, where they are recorded."""
    most = options.get("samples")
    if not isinstance(most, int):
        return ""
    text = f" At most {most:,} samples a decision"
    if {"samples", "decisions"} <= set(rows.columns):
        drawn = rows[rows["planner"] == planner][["samples", "decisions"]].dropna().sum()
        if drawn["decisions"] > 0:
            text += (
                f", {drawn['samples'] / drawn['decisions']:,.0f} on average: a search stops once its answer is settled"
            )
    return f"{text}."
