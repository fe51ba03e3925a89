"""Make the pictures of the documentation: python docs/pictures.py"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

from mrtask import NonlearnedMyopic, Pouct, build_map, fit_on_homes, generate_home, generate_homes, run_experiment
from mrtask.analysis.drawing.floor_plans import draw_home
from mrtask.analysis.drawing.trajectories import draw_trial

FOLDER = Path(__file__).resolve().parent / "img"
DPI = 90


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    home = generate_home(seed=4, size_class="medium")
    figure = Figure(figsize=(6.5, 6.5))
    draw_home(home, build_map(home), figure.add_subplot())
    figure.savefig(FOLDER / "home.png", dpi=DPI, bbox_inches="tight", pil_kwargs={"optimize": True})
    episodes = run_experiment(
        [home],
        {"nonlearned_myopic": NonlearnedMyopic(), "pouct": Pouct(samples=1000)},
        fit_on_homes(generate_homes(12)),
        robots=[2],
        trials_per_cell=6,
    )
    costs = episodes.pivot(index="trial_id", columns="planner", values="cost_s")
    trial = (costs["nonlearned_myopic"] - costs["pouct"]).idxmax()
    rows = episodes[episodes["trial_id"] == trial].to_dict("records")
    drawn = draw_trial(home, {row["planner"]: row | {"trace": row["trace"].to_json()} for row in rows})
    drawn.savefig(FOLDER / "trial.png", dpi=DPI, bbox_inches="tight", pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
