"""The planners by name: what each one is, and how a configuration becomes one.

To add a planner, add an entry to `PLANNERS`: tables, figures and findings follow its role and its place there. Colours
are not in this table, because they decide no result: `mrtask.analysis.page.style` has a default for every planner.

A planner of a user's own needs no entry: its import path (``package.module.name`` of a class or function that takes its
options as keywords and returns a `Planner`) can be given wherever a name is expected.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import import_module

from mrtask.planning.greedy import Greedy
from mrtask.planning.myopic import LearnedMyopic, NonlearnedMyopic
from mrtask.planning.paper.planner import PaperPouct
from mrtask.planning.pouct import Known, Pouct
from mrtask.planning.problem import Planner, PlanOnly

PAPERS_PLANNER = "pouct_paper"
"""The planner that the paper proposes."""


class Role(Enum):
    """What a planner is in a comparison."""

    BASELINE = "baseline"
    """A baseline of the paper: the report gives every planner's improvement over it."""
    REFERENCE = "reference"
    """Another planner that all are compared with."""
    OURS = "ours"
    """A planner under study; users' own planners are such."""
    BOUND = "bound"
    """Knows more than a planner can know: it shows what is left to gain."""


@dataclass(frozen=True)
class PlannerEntry:
    """One planner of the table."""

    planner: Callable[..., Planner]
    """Its class, which takes the options as keywords."""
    role: Role
    published_as: str | None = None
    """The planner in the paper's table of results that it is compared with, by our name for it; None: not in it."""


PLANNERS: Mapping[str, PlannerEntry] = {
    "nonlearned_myopic": PlannerEntry(NonlearnedMyopic, Role.BASELINE, published_as="nonlearned_myopic"),
    "learned_myopic": PlannerEntry(LearnedMyopic, Role.BASELINE, published_as="learned_myopic"),
    "greedy": PlannerEntry(Greedy, Role.REFERENCE),
    "pouct_paper": PlannerEntry(PaperPouct, Role.REFERENCE, published_as=PAPERS_PLANNER),
    "pouct": PlannerEntry(Pouct, Role.OURS, published_as=PAPERS_PLANNER),
    "known": PlannerEntry(Known, Role.BOUND),
}
"""From the simplest planner to the best informed: the order of rows and legends."""


def planner_role(name: str) -> Role:
    """The role of a planner; one that is not in the table is a user's own."""
    return PLANNERS[name].role if name in PLANNERS else Role.OURS


def planners_with_role(role: Role) -> tuple[str, ...]:
    """The planners of the table with this role, in its order."""
    return tuple(name for name, entry in PLANNERS.items() if entry.role is role)


def planners_in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Each name once, in the table's order; users' own planners come by name, after all others but the bounds."""
    present, bounds = set(names), planners_with_role(Role.BOUND)
    first = [name for name in PLANNERS if name in present and name not in bounds]
    last = [name for name in bounds if name in present]
    return (*first, *sorted(present - {*first, *last}), *last)


def published_counterpart(name: str) -> str | None:
    """The planner in the paper's table that this one is compared with: for a user's own, the one the paper proposes.

    None for a planner of ours that has no counterpart there.
    """
    return PLANNERS[name].published_as if name in PLANNERS else PAPERS_PLANNER


def make_planner(name: str, options: Mapping[str, object] | None = None) -> Planner:
    """The planner of that name or import path with the given options.

    Raises:
        ValueError: an unknown name, an import path that leads nowhere, or options the planner refuses.
    """
    factory = PLANNERS[name].planner if name in PLANNERS else _imported(name)
    try:
        planner = factory(**(options or {}))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"planner {name!r} refuses its options: {error}; it takes {inspect.signature(factory)}"
        ) from error
    return planner if isinstance(planner, Planner) else PlanOnly(planner.plan)


def planner_name(planner: Planner) -> str:
    """The planner's name among ours, or the import path of its class (``package.module.Class``)."""
    kind = type(getattr(planner.plan, "__self__", planner))  # of a `PlanOnly`: the class that it stands for
    ours = (name for name, entry in PLANNERS.items() if entry.planner is kind)
    return next(ours, f"{kind.__module__}.{kind.__qualname__}")


def _imported(path: str) -> Callable[..., Planner]:
    module_name, dot, attribute = path.rpartition(".")
    if not dot:
        raise ValueError(
            f"unknown planner {path!r}; allowed are {', '.join(PLANNERS)} or the import path of your own "
            "(package.module.name)"
        )
    try:
        factory: Callable[..., Planner] = getattr(import_module(module_name), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"planner {path!r} cannot be imported: {error}") from error
    return factory
