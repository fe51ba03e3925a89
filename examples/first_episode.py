"""A first episode: a home, where things may be in it, a task, a team, a planner. Needs `pip install mrtask` only."""

from mrtask import Pouct, build_map, fit_on_homes, generate_home, generate_homes, make_trial, run_episode

home = generate_home(seed=4, size_class="small")
home_map = build_map(home)
likelihood = fit_on_homes(generate_homes(count=12, seed=100))  # other homes: nobody may know where things are
trial = make_trial(home, home_map, "F Apple & F Cup", robots=2)
result = run_episode(trial, home, home_map, likelihood, Pouct(samples=1000))
print(result.status, f"after {result.cost_s:.1f} s and {result.decisions} decisions")
for letter in result.trace.letters:
    print(f"{letter.t_s:6.1f} s: robot {letter.robot} has {letter.object} at {letter.container}")
