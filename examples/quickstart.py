"""mrtask in 20 lines: homes, where things may be, planners, and their costs. Needs `pip install mrtask` only."""

from mrtask import Greedy, NonlearnedMyopic, Pouct, fit_on_homes, generate_homes, run_experiment

if __name__ == "__main__":
    homes = list(generate_homes(count=6, seed=1000))
    print(f"{len(homes)} homes, the first a {homes[0].size_class} one with {len(homes[0].containers)} containers")
    likelihood = fit_on_homes(generate_homes(count=12, seed=0))  # other homes: nobody may know where things are
    episodes = run_experiment(
        homes,
        {"nonlearned_myopic": NonlearnedMyopic(), "greedy": Greedy(), "pouct": Pouct(samples=200)},
        likelihood,
        robots=[1, 2],
        trials_per_cell=2,
        on_progress=lambda now: print(f"{now.done}/{now.total}", end=" " if now.done < now.total else "\n"),
    )
    print(episodes.groupby(["size_class", "robots", "planner"]).cost_s.mean().unstack().round(1))
