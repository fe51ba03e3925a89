"""A planner of your own against ours. A planner is any class with ``plan(problem, seed)``; options are keywords.

- here, in a few seconds: `python examples/own_planner.py`
- on the frozen suite, beside ours: `mrtask score examples.own_planner.Cautious`
- in the pipeline: `python -m pipeline.evaluate experiment=smoke
  evaluation.planners=[pouct,examples.own_planner.Cautious] +planner.Cautious.doubt_prob=0.1`

`Cautious` sends each free robot to the nearest container that is worth the walk: one that holds an object that advances
the task, or may hold one with at least ``doubt_prob``.
"""

import numpy as np

from mrtask import (
    WAIT,
    Assignment,
    Greedy,
    NonlearnedMyopic,
    Plan,
    PlanningProblem,
    fit_on_homes,
    generate_homes,
    run_experiment,
)


class Cautious:
    """The nearest container whose chance is at least ``doubt_prob``; the likeliest if none has."""

    def __init__(self, doubt_prob: float = 0.05) -> None:
        self.doubt_prob = doubt_prob

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Legend: C containers, O task objects. ``problem.presence_prob`` [C, O] is the belief."""
        useful = problem.automaton.advancing[problem.state]  # [O] objects that advance the task now
        absent_prob = (1.0 - problem.presence_prob[:, useful]).prod(axis=1)
        chance_prob = 1.0 - absent_prob  # [C] that a container holds one of them
        taken = {robot.target for robot in problem.robots}
        assignments = {}
        for number, robot in enumerate(problem.robots):
            if not robot.free:
                continue
            open_to = np.isfinite(robot.travel_s) & (chance_prob > 0)
            open_to[[container for container in taken if container >= 0]] = False
            worth = open_to & (chance_prob >= self.doubt_prob)
            if worth.any():
                container = int(np.argmin(np.where(worth, robot.travel_s, np.inf)))
            elif open_to.any():
                container = int(np.argmax(np.where(open_to, chance_prob, -1.0)))
            else:
                container = WAIT
            assignments[number] = Assignment(container)
            taken.add(container)
        return Plan(assignments)


if __name__ == "__main__":
    episodes = run_experiment(
        list(generate_homes(count=6, seed=1000)),
        {
            "nonlearned_myopic": NonlearnedMyopic(),
            "cautious, 2 %": Cautious(doubt_prob=0.02),
            "cautious, 20 %": Cautious(doubt_prob=0.20),
            "greedy": Greedy(),
        },
        fit_on_homes(generate_homes(count=12)),
        robots=[1, 2],
        trials_per_cell=3,
    )
    print(episodes.groupby("planner").cost_s.agg(["count", "mean"]).round(1))
