"""The paper's trials of two robots in real apartments, beside our simulation of them (``pipeline.scenario``)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import dist

from mrtask.analysis.results.manifest import Manifest, part
from mrtask.analysis.results.published import RealWorldTrial
from mrtask.execution.trace import Trace
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.formula import parse, proposition_names

APARTMENTS = "apartments"
"""The manifest's part on simulated trials: apartment -> planner -> `SimulatedTrial`'s fields."""


@dataclass(frozen=True)
class SimulatedTrial:
    """One planner's simulated run of one of the apartments' tasks."""

    metres: float
    """How far the robot that drove longest had driven when the task was done."""
    finished: bool
    """Whether its interactions spell a word that the published formula accepts."""

    def as_dict(self) -> dict[str, float | bool]:
        """Its fields, for the manifest."""
        return asdict(self)


def scenario_name(trial: RealWorldTrial) -> str:
    """What ``pipeline.scenario`` calls an apartment."""
    return trial.name.replace(" ", "")


def driven_m(trace: Trace) -> list[float]:
    """How far each robot drove, in metres."""
    return [sum(dist(*ends) for leg in legs for ends in pairwise(leg.path)) for legs in trace.robots]


def simulated_trial(trial: RealWorldTrial, trace: Trace) -> SimulatedTrial:
    """The distance and success of a trace of the apartment's task."""
    names = proposition_names(parse(trial.formula))
    automaton = build_automaton(trial.formula, names)
    word = [letter.object for letter in trace.letters]
    finished = set(word) <= set(names) and bool(automaton.accepting[automaton.run(word)])
    return SimulatedTrial(max(driven_m(trace)), finished)


def simulated_trials(manifest: Manifest, trial: RealWorldTrial) -> Mapping[str, SimulatedTrial]:
    """Planner -> its simulated run of an apartment, from the manifest."""
    found = part(part(manifest, APARTMENTS), trial.name)
    return {planner: SimulatedTrial(**fields) for planner, fields in found.items()}
