"""Compare pomdp-py's POUCT with ours on the frozen suite's single-robot trials, with the same time for each decision.

    pip install pomdp-py && python benchmarks/bench_peers.py --trials 12 --seconds 0.2

pomdp-py (Zheng and Tellex 2020) searches the problem as its user would write it down. A state is the robot's place, the
task's state, what was searched and what lies where; an action is a container; an observation is what a search shows.
Its root belief is drawn from ours, conditioned on every object existing, so both know the same. Its rollouts are random
over containers that can still help. Our planner runs with a time limit instead of a number of samples.
"""

import argparse
import random
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from mrtask.analysis.results.statistics import improvement_percent, paired_costs
from mrtask.execution.episode import run_episode, warm_up
from mrtask.execution.trials import Trial
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import Assignment, Plan, PlanInfo, PlanningProblem, safe
from mrtask.suite.frozen import load_suite

try:
    import pomdp_py
except ImportError as error:
    raise SystemExit("pomdp-py is needed for this comparison: pip install pomdp-py") from error

WORLDS = 1000
MANY_SAMPLES = 10**8
MANY_NODES = 10**6


class Where(pomdp_py.State):
    """``place`` (-1: the start), the automaton's ``task`` state, ``searched`` containers and what each ``holds``."""

    def __init__(self, place: int, task: int, searched: frozenset[int], holds: tuple[int, ...]) -> None:
        self.key = (place, task, searched, holds)
        self.place, self.task, self.searched, self.holds = self.key

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Where) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


class GoTo(pomdp_py.Action):
    """Go to a container, search it, and interact with what advances the task there."""

    def __init__(self, container: int) -> None:
        self.container = container

    def __eq__(self, other: object) -> bool:
        return isinstance(other, GoTo) and self.container == other.container

    def __hash__(self) -> int:
        return self.container


class Seen(pomdp_py.Observation):
    """The task objects in the container, as a bit mask."""

    def __init__(self, objects: int) -> None:
        self.objects = objects

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Seen) and self.objects == other.objects

    def __hash__(self) -> int:
        return self.objects


class Domain:
    """The problem's dynamics, the same as the simulation's for one robot."""

    def __init__(self, problem: PlanningProblem) -> None:
        self.problem, self.automaton = problem, problem.automaton
        self.safe = safe(problem.automaton)
        self.from_start_s = problem.robots[0].travel_s
        self.reachable = np.flatnonzero(np.isfinite(self.from_start_s)).tolist()

    def travel_s(self, place: int, container: int) -> float:
        ways_s = self.from_start_s if place < 0 else self.problem.travel_s[place]
        return float(ways_s[container])

    def after(self, state: Where, action: GoTo) -> Where:
        if self.automaton.accepting[state.task]:
            return state
        container, task = action.container, state.task
        while True:
            here = [obj for obj in range(self.safe.shape[1]) if state.holds[container] >> obj & 1]
            advancing = [obj for obj in here if self.safe[task, obj]]
            if not advancing:
                return Where(container, task, state.searched | {container}, state.holds)
            task = int(self.automaton.transitions[task, advancing[0]])

    def choices(self, state: Where) -> list[GoTo]:
        """Return the unsearched containers, and those known to hold an object that advances the task."""
        return [
            GoTo(container)
            for container in self.reachable
            if container != state.place
            and (
                container not in state.searched
                or any(state.holds[container] >> obj & 1 for obj in np.flatnonzero(self.safe[state.task]))
            )
        ] or [GoTo(self.reachable[0])]

    def worlds(self, rng: np.random.Generator) -> Iterable[Where]:
        """Draw states from the belief in which every object is somewhere."""
        probs = self.problem.presence_prob.copy()
        probs[[container for container in range(len(probs)) if container not in self.reachable]] = 0.0
        known = self.problem.found()
        there = np.zeros((WORLDS, *probs.shape), dtype=bool)
        for obj in range(probs.shape[1]):
            # Container by container, each given that an object not yet drawn anywhere must be in one of those to come.
            somewhere = np.full(WORLDS, known[obj])
            for container, prob in enumerate(probs[:, obj]):
                left = 1.0 - np.prod(1.0 - probs[container:, obj])
                must = prob / left if left > 0 else 0.0
                there[:, container, obj] = rng.random(WORLDS) < np.where(somewhere, prob, must)
                somewhere |= there[:, container, obj]
        searched = frozenset(np.flatnonzero(self.problem.searched).tolist())
        bits = 1 << np.arange(probs.shape[1])
        for holds in (there * bits).sum(axis=2).tolist():
            yield Where(-1, self.problem.state, searched, tuple(holds))


class Transition(pomdp_py.TransitionModel):
    """The transition model: the state after an action."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain

    def sample(self, state: Where, action: GoTo) -> Where:
        return self.domain.after(state, action)


class Observing(pomdp_py.ObservationModel):
    """The observation model: what the robot sees after an action."""

    def sample(self, next_state: Where, action: GoTo) -> Seen:
        return Seen(next_state.holds[action.container])


class Reward(pomdp_py.RewardModel):
    """The reward model: minus the seconds that an action takes."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain

    def sample(self, state: Where, action: GoTo, next_state: Where) -> float:
        if self.domain.automaton.accepting[state.task]:
            return 0.0
        return -self.domain.travel_s(state.place, action.container)


class Choices(pomdp_py.RolloutPolicy):
    """The policy model: the possible actions, and a random one of them."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain

    def get_all_actions(self, state: Where, history: Any = None) -> list[GoTo]:
        return self.domain.choices(state)

    def sample(self, state: Where) -> GoTo:
        return random.choice(self.get_all_actions(state))

    def rollout(self, state: Where, history: Any = None) -> GoTo:
        return random.choice(self.get_all_actions(state))


class PomdpPy:
    """pomdp-py's POUCT as a planner of mrtask for one robot."""

    knows_contents = False

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        random.seed(seed)
        began_s = time.perf_counter()
        domain = Domain(problem)
        belief = pomdp_py.Particles(list(domain.worlds(np.random.default_rng(seed))))
        agent = pomdp_py.Agent(belief, Choices(domain), Transition(domain), Observing(), Reward(domain))
        ways_s = domain.from_start_s[domain.reachable]
        search = pomdp_py.POUCT(
            max_depth=len(domain.reachable) + 2,
            planning_time=max(self.seconds - (time.perf_counter() - began_s), 0.01),
            discount_factor=1.0,
            exploration_const=float(ways_s.mean()),
            rollout_policy=agent.policy_model,
        )
        chosen = search.plan(agent)
        info = PlanInfo(time.perf_counter() - began_s, samples=int(search.last_num_sims))
        return Plan({0: Assignment(chosen.container)}, info)


def main() -> None:
    """Print mean costs on the same trials, and what our planner saves with 95 % intervals."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=0.2, help="for each decision")
    options = parser.parse_args()
    suite = load_suite()
    single = [trial for trial in suite.trials if trial.team.robots == 1]
    chosen = single[:: max(1, len(single) // options.trials)][: options.trials]
    planners = {
        "pomdp-py POUCT": PomdpPy(options.seconds),
        "pouct": make_planner(
            "pouct", {"samples": MANY_SAMPLES, "time_limit_s": options.seconds, "max_nodes": MANY_NODES}
        ),
        "greedy": make_planner("greedy"),
        "learned_myopic": make_planner("learned_myopic"),
    }
    for name in ("pouct", "greedy"):
        warm_up(*_arguments(chosen[0]), planners[name])
    rows = []
    for trial in chosen:
        for name, planner in planners.items():
            result = run_episode(*_arguments(trial), planner, name)
            rows.append({"planner": name, "trial": trial.trial_id, **vars(result)})
            print(f"{trial.trial_id} {name}: {result.status} {result.cost_s}", flush=True)
    frame = pd.DataFrame(rows)
    per_decision = (
        frame.groupby("planner")[["planning_s", "samples"]]
        .sum()
        .div(frame.groupby("planner")["decisions"].sum(), axis=0)
    )
    print(frame.groupby("planner")["cost_s"].agg(["count", "mean"]).join(per_decision).sort_values("mean").round(3))
    home_of = {trial.trial_id: trial.home_id for trial in chosen}
    costs = paired_costs(frame.rename(columns={"trial": "trial_id"}))
    homes = [home_of[trial] for trial in costs.index]
    for name in costs.columns.drop("pouct"):
        saved = improvement_percent(costs["pouct"].to_numpy(), costs[name].to_numpy(), homes)
        print(f"pouct over {name}: {saved.value:.1f} % ({saved.low:.1f}, {saved.high:.1f})")


def _arguments(trial: Trial) -> tuple[Any, ...]:
    suite = load_suite()
    home = suite.homes[trial.home_id]
    return trial, home, suite.map_of(home.id), suite.table.matrix(home, trial.objects)


if __name__ == "__main__":
    main()
