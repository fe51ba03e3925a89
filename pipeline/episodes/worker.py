"""Runs one episode in a worker: from its key and what all episodes share to one row of the results.

A worker keeps what it has read or computed (homes by class, the last maps and trials) for the trial's other planners.
"""

import resource
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.episode import Observer, run_episode, warm_up
from mrtask.execution.team_maps import MakeMap, maps_for, start_cells
from mrtask.execution.trials import Trial, TrialOptions, home_order, key_seed, sample_trial, trial_id
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import AdaptOptions, Sighting, adapted, sightings_of
from mrtask.likelihood.choice import chosen_likelihood
from mrtask.likelihood.table import LikelihoodTable
from mrtask.maps.home_map import HomeMap, map_bytes
from pipeline.base.specs import MapOptions, PlannerSpec
from pipeline.store.episode_row import EpisodeRow

CONTEXTS_KEPT = 8
MAPS_KEPT = 8
MAPS_KEPT_BYTES = 2 * 1024**3
"""Of maps as large as a residence's, a worker keeps fewer, at least one."""
TRIALS_KEPT = 64


@dataclass(frozen=True)
class EpisodeKey:
    """Which episode: the trial's cell and number, and the planner's name. Nothing else decides what happens in it."""

    size_class: str
    robots: int
    number: int
    planner: str

    @property
    def trial_id(self) -> str:
        """The trial's key, shared by all planners."""
        return trial_id(self.size_class, self.robots, self.number)


@dataclass(frozen=True)
class Provenance:
    """What made a row."""

    model_version: str
    config_hashes: Mapping[str, str]
    """By planner."""
    code_version: str


@dataclass(frozen=True, eq=False)
class Context:
    """What all episodes of an evaluation share; sent to each worker once."""

    homes: tuple[Home, ...]
    table: LikelihoodTable
    maps: MapOptions
    seed: int
    trials: TrialOptions
    planners: Mapping[str, PlannerSpec]
    """By name."""
    provenance: Provenance
    truth: LikelihoodTable | None = None
    """The true likelihoods, where a planner plans with them."""
    home_order: str = "shuffled"
    adapt: AdaptOptions | None = None
    """How the likelihoods of a home are corrected by what its earlier tasks showed; None: not at all."""

    @property
    def own_modules(self) -> tuple[str, ...]:
        """The modules of the user's own planners."""
        paths = (spec.planner.rpartition(".")[0] for spec in self.planners.values())
        return tuple(dict.fromkeys(module for module in paths if module))


def map_home(number: int, context: Context) -> tuple[int, int]:
    """Map the home of this number into the cache; return how many containers it has and how many can be reached.

    Raises:
        InputError: a robot of the team does not fit where it is to start.
    """
    home, team = context.homes[number], context.trials.team
    home_map = context.maps.map_of(home)
    if team is not None:
        maps = maps_for(team, home, home_map, partial(context.maps.map_of, home))
        row, col = np.argwhere(home_map.free)[0]
        start_cells(team, maps, (int(row), int(col)))
    return len(home_map.reachable), int(home_map.reachable.sum())


def run_chain(
    keys: tuple[EpisodeKey, ...], context: Context, observe: Observer | None = None
) -> tuple[EpisodeRow, ...]:
    """Return the rows of a planner's episodes in one home, in order; where beliefs adapt, each learns from the earlier.

    ``observe`` is called at each decision of the last one.
    """
    seen: list[Sighting] = []
    rows = []
    for task, key in enumerate(keys):
        row, sightings = _run(key, task, seen, context, observe if key is keys[-1] else None)
        rows.append(row)
        seen += sightings
    return tuple(rows)


def run_one(key: EpisodeKey, context: Context) -> EpisodeRow:
    """Return the row of a finished episode, accepted or failed, of a team that knows nothing of the home yet."""
    return _run(key, 0, (), context)[0]


def _run(
    key: EpisodeKey, task: int, seen: Sequence[Sighting], context: Context, observe: Observer | None = None
) -> tuple[EpisodeRow, tuple[Sighting, ...]]:
    """Return an episode's row and what it showed, given what earlier tasks in the home showed."""
    began_s = time.perf_counter()
    spec = context.planners[key.planner]
    trial, home, home_map, likelihood = setting(key, context, task, seen)
    make_map = bench_of(context).maker_of(home.id)
    result = run_episode(
        trial, home, home_map, likelihood, spec.make(), spec.planner, observe=observe, make_map=make_map
    )
    start_x_m, start_y_m = result.trace.start
    row = replace(
        unfinished_row(key, context, result.status, result.error),
        home_id=home.id,
        home_source=home.source,
        template=trial.template,
        formula=trial.formula,
        objects=trial.objects,
        cost_s=result.cost_s,
        cost_cells=result.cost_cells,
        decisions=result.decisions,
        planning_s=result.planning_s,
        samples=result.samples,
        seed=trial.seed,
        start_x_m=start_x_m,
        start_y_m=start_y_m,
        trace=result.trace.to_json(),
        wall_s=time.perf_counter() - began_s,
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )
    return row, sightings_of(home, task, result.searched, trial.objects)


def setting(
    key: EpisodeKey, context: Context, task: int = 0, seen: Sequence[Sighting] = ()
) -> tuple[Trial, Home, HomeMap, NDArray[np.float64]]:
    """Return what an episode runs on: the trial, its home and map, and the planner's likelihoods."""
    bench = bench_of(context)
    trial = bench.trial(key.size_class, key.robots, key.number)
    home = bench.homes[trial.home_id]
    likelihood = planning_likelihood(
        home, trial.objects, trial.seed, context.planners[key.planner], context, task, seen
    )
    return trial, home, bench.map_of(trial.home_id), likelihood


def planning_likelihood(
    home: Home,
    objects: Sequence[str],
    seed: int,
    spec: PlannerSpec,
    context: Context,
    task: int = 0,
    seen: Sequence[Sighting] = (),
) -> NDArray[np.float64]:
    """Return the planner's ``P(object in container)``, ``[C, O]``; where beliefs adapt, ``seen`` corrects it."""
    table = context.table if spec.likelihood.source == "model" else context.truth
    if table is None:
        raise ValueError(f"{spec.name} plans with the true likelihoods, which this evaluation does not have")
    known = tuple(dict.fromkeys([*objects, *(sighting.object for sighting in seen)]))
    kinds = home.container_kinds()
    prior = chosen_likelihood(table.matrix(home, known), kinds, spec.likelihood, key_seed(seed, "likelihood"))
    if context.adapt is None or not seen:
        return prior[:, : len(objects)]
    return adapted(prior, known, kinds, seen, task, context.adapt)[:, : len(objects)]


def warm(key: EpisodeKey, context: Context) -> None:
    """Compile what the planner needs."""
    spec = context.planners[key.planner]
    trial, home, home_map, likelihood = setting(key, context)
    warm_up(trial, home, home_map, likelihood, spec.make(), bench_of(context).maker_of(home.id))


def run_warm(key: EpisodeKey, context: Context) -> EpisodeRow:
    """Return the row of `run_one` as later episodes run: what a worker does once for each planner is done before."""
    warmed = bench_of(context).warmed
    if key.planner not in warmed:
        warm(key, context)
        warmed.add(key.planner)
    return run_one(key, context)


def unfinished_row(key: EpisodeKey, context: Context, status: str, error: str | None) -> EpisodeRow:
    """Return the row of an episode of which nothing more is known; the driver can make it too."""
    made_by = context.provenance
    return EpisodeRow(
        trial_id=key.trial_id,
        size_class=key.size_class,
        robots=key.robots,
        team=context.trials.team_name,
        planner=key.planner,
        status=status,
        error=error,
        model_version=made_by.model_version,
        config_hash=made_by.config_hashes[key.planner],
        code_version=made_by.code_version,
    )


class Bench:
    """A context as one worker uses it."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.warmed: set[str] = set()
        self.homes = {home.id: home for home in context.homes}
        largest = max(map_bytes(home, context.maps.grid.resolution_m) for home in context.homes)
        kept = min(MAPS_KEPT, max(MAPS_KEPT_BYTES // largest, 1))
        self.map_of = lru_cache(maxsize=kept)(
            lambda home_id, radius_m=None: context.maps.map_of(self.homes[home_id], radius_m)
        )
        self.trial = lru_cache(maxsize=TRIALS_KEPT)(self._sample)
        self._order = lru_cache(maxsize=None)(
            lambda size_class, robots: home_order(context.homes, size_class, robots, context.seed, context.home_order)
        )

    def maker_of(self, home_id: str) -> MakeMap:
        """Return what makes the home's maps for robots of another radius."""
        return partial(self.map_of, home_id)

    def _sample(self, size_class: str, robots: int, number: int) -> Trial:
        context = self._context
        order = self._order(size_class, robots)
        map_of = self.map_of
        return sample_trial(
            size_class,
            robots,
            number,
            order,
            lambda home: map_of(home.id),
            seed=context.seed,
            options=context.trials,
        )


@lru_cache(maxsize=CONTEXTS_KEPT)
def bench_of(context: Context) -> Bench:
    """Return the bench of a context; a worker keeps those of the cells that run side by side."""
    return Bench(context)
