"""The published results (``published.toml``) with which ours are compared.

Source: Khanal, Paudel, Pham, Stein, *Multi-Robot Learning-Informed Task Planning Under Uncertainty*, ICRA 2026
(arXiv 2603.20544): the table of mean costs in simulation and the two-robot trials in real apartments.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from mrtask.planning.planners import PAPERS_PLANNER, published_counterpart

Cell = tuple[str, int]
"""``(size class, robots)``: one column of the paper's table."""


@dataclass(frozen=True)
class RealWorldTrial:
    """A trial of two robots in a real apartment; navigation costs in metres."""

    name: str
    containers: tuple[str, ...]
    objects: Mapping[str, str]
    """The container that holds each object."""
    task: str
    formula: str
    myopic_m: float
    planner_m: float


@dataclass(frozen=True)
class Published:
    """The paper's figures: costs in grid cells of 0.05 m, improvements in percent."""

    authors: tuple[str, ...]
    """``Family, Given`` of each author."""
    title: str
    booktitle: str
    year: int
    arxiv: str
    citation: str
    url: str
    cost_cells: Mapping[tuple[str, Cell], float]
    """The mean cost by ``(planner, cell)``; planners have our names."""
    improvement_percent: Mapping[tuple[str, Cell], float]
    """The improvement of the paper's planner by ``(baseline, cell)``."""
    real_world: tuple[RealWorldTrial, ...]

    @property
    def planners(self) -> tuple[str, ...]:
        """Return the planners of the paper's table, by our names, in its order."""
        return tuple(dict.fromkeys(planner for planner, _ in self.cost_cells))

    def cost_of(self, planner: str, cell: Cell) -> float | None:
        """Return the published mean cost of the `published_counterpart` of one of our planners."""
        counterpart = published_counterpart(planner)
        return None if counterpart is None else self.cost_cells.get((counterpart, cell))

    def improvement_of(self, planner: str, baseline: str, cell: Cell) -> float | None:
        """Return the published improvement to compare with ours of ``planner`` over ``baseline``, in percent.

        For the paper's planner, it is the printed figure; between the paper's baselines, the printed means give it.
        """
        if published_counterpart(planner) == PAPERS_PLANNER:
            return self.improvement_percent.get((baseline, cell))
        cost, base_cost = self.cost_of(planner, cell), self.cost_of(baseline, cell)
        return None if planner == baseline or cost is None or base_cost is None else 100 * (1 - cost / base_cost)


@cache
def load_published() -> Published:
    """Read the packaged table."""
    raw = tomllib.loads(resources.files(__package__).joinpath("published.toml").read_text(encoding="utf-8"))
    source = raw["source"]

    def table(part: str) -> dict[tuple[str, Cell], float]:
        return {
            (name, (size_class, robots)): float(value)
            for name, by_class in raw[part].items()
            for size_class, values in by_class.items()
            for robots, value in zip(raw["robots"], values, strict=True)
        }

    return Published(
        authors=tuple(source["names"]),
        title=source["title"],
        booktitle=source["booktitle"],
        year=source["year"],
        arxiv=source["arxiv"],
        citation=f"{source['authors']}: {source['title']}. {source['venue']}, arXiv {source['arxiv']}",
        url=f"https://arxiv.org/abs/{source['arxiv']}",
        cost_cells=table("cost_cells"),
        improvement_percent=table("improvement_percent"),
        real_world=tuple(RealWorldTrial(**{**t, "containers": tuple(t["containers"])}) for t in raw["real_world"]),
    )
