"""Runs one task in one home with each planner and prints how many metres the robots drove.

    python -m pipeline.scenario name=apartment1
    python -m pipeline.scenario map=lab.yaml containers=containers.yaml task="pillow and remote" robots=2

Each planner runs with several seeds, and the table shows the means over the seeds. The files in output_dir (default
outputs/scenario/<name>) show the first seed: replay.html plays all planners side by side, plans.png draws the first
search planner next to the first baseline, and traces/<planner>.json holds each planner's drives. conf/scenario.yaml
lists every key with its default. Planners' options are set as in planner.pouct.samples=1000.
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean

from mrtask.analysis.drawing.replay_content import Episode, Recorder, make_replay
from mrtask.analysis.drawing.replay_page import render_replay
from mrtask.analysis.drawing.trajectories import draw_trial
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report.real_world import driven_m
from mrtask.analysis.results.published import RealWorldTrial, load_published
from mrtask.execution.episode import EpisodeResult, run_episode
from mrtask.execution.scenario import Scenario, drawn_worlds, make_scenario
from mrtask.execution.team_spec import Team
from mrtask.execution.trials import key_seed
from mrtask.maps.ros_map import map_worlds, scan_floor
from mrtask.names import counted
from mrtask.planning.planners import Role, make_planner, planner_role, planners_in_order
from mrtask.tasks.automaton import build_automaton
from pipeline.app.map_task import ScenarioOptions, scenario_files
from pipeline.app.tool import load_options, main, overrides
from pipeline.base import console
from pipeline.base.config import UserError

VERBATIM = ("task", "name")
BASELINE = "nonlearned_myopic"


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    given = overrides(arguments, VERBATIM)
    options = load_options(ScenarioOptions, scenario_files(given, "scenario.yaml"), given)
    folder = options.output_dir / (options.name or options.map.stem)
    console.headline("map", options.map.name)
    scan = scan_floor(options.map, options.containers)
    console.text("\n".join(scan.told))
    [home] = map_worlds(scan, 1, options.seed)
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
    x, y = scenario.home_map.cell_center(trial.start_cell)
    console.line(f"{counted(options.robots, 'robot')} from ({x:.1f}, {y:.1f})")
    if out_of_reach := scenario.home_map.out_of_reach(home):
        console.line(f"warning: {out_of_reach}")
    console.text("\n".join(likelihoods(scenario)))
    recorders = {name: Recorder() for name in planners_in_order(options.planners)}
    results = {
        name: [_run(scenario, name, options, number, None if number else recorder) for number in range(options.seeds)]
        for name, recorder in recorders.items()
    }
    console.text("\n".join(table(results, _published(options.published))))
    if worlds := drawn_worlds(scenario, options.drawn_worlds, options.seed):
        console.line(f"over {counted(len(worlds), 'world')} drawn from these likelihoods")
        in_worlds = [replace(scenario, home=world) for world in worlds]
        means = {name: [_run(world, name, options, 0, None) for world in in_worlds] for name in results}
        console.text("\n".join(table(means, None)))
    first = {name: of_seeds[0] for name, of_seeds in results.items()}
    (folder / "traces").mkdir(parents=True, exist_ok=True)
    for name, result in first.items():
        (folder / "traces" / f"{name}.json").write_text(result.trace.to_json() + "\n", encoding="utf-8")
    command = f"python -m pipeline.scenario {shlex.join(arguments)}"
    (folder / "replay.html").write_text(_replay(scenario, first, recorders, options, command), encoding="utf-8")
    _draw(scenario, first).savefig(folder / "plans.png", dpi=150)  # type: ignore[attr-defined]
    console.line(f"-> {console.shown(folder)}")


def _run(
    scenario: Scenario, name: str, options: ScenarioOptions, number: int, observe: Recorder | None
) -> EpisodeResult:
    """Run an episode with the seed of this number and return its result."""
    trial = replace(scenario.trial, seed=key_seed(options.seed + number, "planner", scenario.trial.trial_id))
    planner = make_planner(name, options.options_of(name))
    return run_episode(trial, scenario.home, scenario.home_map, scenario.likelihood, planner, name, observe=observe)


def likelihoods(scenario: Scenario) -> list[str]:
    """Return a table of what planners know at the start: how likely each container holds each object.

    A ``*`` marks where the object really is.
    """
    objects = scenario.trial.objects
    lines = [f"{'likelihood':<24}" + "".join(f"{name:>12}" for name in objects)]
    for container, probs in zip(scenario.home.containers, scenario.likelihood, strict=True):
        told = (
            f"{'*' if name in container.objects else ''}{prob:.3f}" for name, prob in zip(objects, probs, strict=True)
        )
        lines.append(f"{container.id:<24}" + "".join(f"{text:>12}" for text in told))
    return lines


def metres(result: EpisodeResult) -> tuple[float, float]:
    """Return the longest distance that one robot drove, and the total of all robots."""
    each = driven_m(result.trace)
    return max(each), sum(each)


def table(results: Mapping[str, Sequence[EpisodeResult]], published: RealWorldTrial | None) -> list[str]:
    """Return a table of the planners' metres, averaged over seeds or worlds, with the paper's figures if it has any."""
    base_m = _mean_metres(results.get(BASELINE, ()))
    lines = [f"{'planner':<24}{'metres':>8}{'least':>8}{'most':>8}{'together':>10}{'decisions':>11}{'saved':>8}"]
    for name, of_seeds in results.items():
        failed = next((result.error for result in of_seeds if result.error is not None), None)
        mean_m = _mean_metres(of_seeds)
        if mean_m is None:
            lines.append(f"{planner_label(name):<24}{'failed':>8}  {failed}")
            continue
        each, together = zip(*map(metres, of_seeds), strict=True)
        decisions = fmean(result.decisions for result in of_seeds)
        saved = f"{1 - mean_m / base_m:8.0%}" if base_m and name != BASELINE else ""
        lines.append(
            f"{planner_label(name):<24}{mean_m:8.2f}{min(each):8.2f}{max(each):8.2f}{fmean(together):10.2f}"
            f"{decisions:11.1f}{saved}"
        )
    if published is not None:
        lines += [
            f"published, {published.name}, another geometry: myopic {published.myopic_m:.2f} m, the paper's planner "
            f"{published.planner_m:.2f} m, {1 - published.planner_m / published.myopic_m:.0%} saved"
        ]
    return lines


def _mean_metres(of_seeds: Sequence[EpisodeResult]) -> float | None:
    """Return the mean distance; None if any seed failed or none ran."""
    if not of_seeds or any(result.error is not None for result in of_seeds):
        return None
    return fmean(metres(result)[0] for result in of_seeds)


def _replay(
    scenario: Scenario,
    results: Mapping[str, EpisodeResult],
    recorders: Mapping[str, Recorder],
    options: ScenarioOptions,
    command: str,
) -> str:
    """Return a page that plays all planners side by side."""
    trial = scenario.trial
    episodes = [
        Episode(name, result.status, result.cost_s, result.error, result.trace, recorders[name].decisions)
        for name, result in results.items()
    ]
    automaton = build_automaton(trial.formula, trial.objects)
    replay = make_replay(trial.trial_id, trial.size_class, trial.template, automaton, scenario.home, episodes)
    return render_replay(replace(replay, task=options.task), command)


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
