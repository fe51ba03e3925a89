"""Runs one task in one home by every planner and prints the metres that each needed.

    python -m pipeline.scenario name=apartment1
    python -m pipeline.scenario map=lab.yaml containers=containers.yaml task="pillow and remote" robots=2

Writes into output_dir (default outputs/scenario/<name>): plans.png, the first of the search planners beside the first
baseline, and traces/<planner>.json. Every key, with its default: conf/scenario.yaml; planners' options are
planner.pouct.samples=1000 and the like.
"""

import json
from collections.abc import Mapping, Sequence

from mrtask.analysis.published import RealWorldTrial, load_published
from mrtask.analysis.real_world import driven_m
from mrtask.analysis.style import planner_label
from mrtask.analysis.trajectories import draw_trial
from mrtask.execution.episode import EpisodeResult, run_episode
from mrtask.execution.scenario import Scenario, make_scenario
from mrtask.execution.team import Team
from mrtask.maps.ros_map import read_map_worlds
from mrtask.planning.planners import Role, planner_role, planners_in_order
from pipeline.app.given import GivenTrial, scenario_files
from pipeline.app.tool import load_options, main, overrides
from pipeline.base import console
from pipeline.base.config import UserError

VERBATIM = ("task", "name")
BASELINE = "nonlearned_myopic"


def run(arguments: Sequence[str]) -> None:
    """The tool."""
    given = overrides(arguments, VERBATIM)
    options = load_options(GivenTrial, scenario_files(given, "scenario.yaml"), given)
    folder = options.output_dir / (options.name or options.map.stem)
    home = read_map_worlds(options.map, options.containers, 1, options.seed)[0]
    scenario = make_scenario(
        options.name or options.map.stem,
        home,
        options.map_of(home),
        options.model(),
        options.task,
        Team(options.robots, options.spec),
        start_m=options.start,
        objects=options.objects,
        seed=options.seed,
    )
    trial = scenario.trial
    console.headline("scenario", f"{trial.trial_id}: {options.task}")
    console.line(f"formula {trial.formula}")
    console.line(
        f"{len(home.containers)} containers, {home.area_m2:.0f} m2, {options.robots} robots from "
        "({:.1f}, {:.1f})".format(*scenario.home_map.cell_center(trial.start_cell))
    )
    results = {
        name: run_episode(trial, scenario.home, scenario.home_map, scenario.likelihood, name, options.options_of(name))
        for name in planners_in_order(options.planners)
    }
    for text in table(results, _published(options.published)):
        console.line(text)
    (folder / "traces").mkdir(parents=True, exist_ok=True)
    for name, result in results.items():
        (folder / "traces" / f"{name}.json").write_text(result.trace.to_json() + "\n", encoding="utf-8")
    _draw(scenario, results).savefig(folder / "plans.png", dpi=150)  # type: ignore[attr-defined]
    console.line(f"-> {console.shown(folder)}")


def metres(result: EpisodeResult) -> tuple[float, float]:
    """How far the robot that drove longest had driven when the task was done, and all robots together."""
    each = driven_m(result.trace)
    return max(each), sum(each)


def table(results: Mapping[str, EpisodeResult], published: RealWorldTrial | None) -> list[str]:
    """The planners' metres, and the paper's where the scenario is one of its."""
    base = results.get(BASELINE)
    base_m = metres(base)[0] if base is not None and base.error is None else None
    lines = [f"{'planner':<24}{'metres':>8}{'together':>10}{'decisions':>11}{'saved':>8}"]
    for name, result in results.items():
        if result.error is not None:
            lines.append(f"{planner_label(name):<24}{'failed':>8}  {result.error}")
            continue
        longest_m, together_m = metres(result)
        saved = f"{1 - longest_m / base_m:8.0%}" if base_m and name != BASELINE else ""
        lines.append(f"{planner_label(name):<24}{longest_m:8.2f}{together_m:10.2f}{result.decisions:11}{saved}")
    if published is not None:
        lines += [
            f"published, {published.name}, another geometry: myopic {published.myopic_m:.2f} m, the paper's planner "
            f"{published.planner_m:.2f} m, {1 - published.planner_m / published.myopic_m:.0%} saved"
        ]
    return lines


def _published(name: str | None) -> RealWorldTrial | None:
    if name is None:
        return None
    known = {trial.name: trial for trial in load_published().real_world}
    if name not in known:
        raise UserError(f"published={name}: the paper has no such trial; allowed: {', '.join(known)}")
    return known[name]


def _draw(scenario: Scenario, results: Mapping[str, EpisodeResult]) -> object:
    done = [name for name, result in results.items() if result.error is None]
    ours = [name for name in done if planner_role(name) is Role.OURS]
    chosen = dict.fromkeys([*ours[:1], *(name for name in done if planner_role(name) is Role.BASELINE)][:2] or done[:1])
    rows = {
        name: {
            "trace": results[name].trace.to_json(),
            "cost_s": results[name].cost_s,
            "objects": json.dumps(scenario.trial.objects),
        }
        for name in chosen
    }
    return draw_trial(scenario.home, rows)


if __name__ == "__main__":
    main(run, __doc__ or "")
