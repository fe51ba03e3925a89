"""The planners by name, and how a configuration becomes one.

A planner of a user's own needs no entry here: its import path (``package.module.name`` of a class or function that
takes its options as keywords and returns a `Planner`) stands wherever a name does.
"""

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module

from mrtask.planning.greedy import Greedy
from mrtask.planning.myopic import learned_myopic, nonlearned_myopic
from mrtask.planning.paper import PaperOptions, PaperPouct
from mrtask.planning.pouct import Known, Pouct, PouctOptions
from mrtask.planning.problem import Planner, PlanOnly


def pouct(**options: object) -> Planner:
    """`Pouct` with `PouctOptions` as keywords."""
    return Pouct(PouctOptions(**options))  # type: ignore[arg-type]


def pouct_paper(**options: object) -> Planner:
    """`PaperPouct` with `PaperOptions` as keywords."""
    return PaperPouct(PaperOptions(**options))  # type: ignore[arg-type]


def known(**options: object) -> Planner:
    """`Known` with `PouctOptions` as keywords."""
    return Known(PouctOptions(**options))  # type: ignore[arg-type]


PLANNERS: Mapping[str, Callable[..., Planner]] = {
    "nonlearned_myopic": nonlearned_myopic,
    "learned_myopic": learned_myopic,
    "pouct_paper": pouct_paper,
    "pouct": pouct,
    "greedy": Greedy,
    "known": known,
}

OPTIONS: Mapping[str, Callable[..., object]] = {
    "pouct": PouctOptions,
    "known": PouctOptions,
    "pouct_paper": PaperOptions,
}


def make_planner(name: str, options: Mapping[str, object] | None = None) -> Planner:
    """The planner of that name or import path with the given options.

    Raises:
        ValueError: an unknown name, an import path that leads nowhere, or options the planner refuses.
    """
    if name in PLANNERS:
        factory = PLANNERS[name]
    elif "." in name:
        module_name, _, attribute = name.rpartition(".")
        try:
            factory = getattr(import_module(module_name), attribute)
        except (ImportError, AttributeError) as error:
            raise ValueError(f"planner {name!r} cannot be imported: {error}") from error
    else:
        raise ValueError(
            f"unknown planner {name!r}; allowed are {', '.join(PLANNERS)} or the import path of your own "
            "(package.module.name)"
        )
    try:
        planner = factory(**(options or {}))
    except (TypeError, ValueError) as error:
        accepted = OPTIONS.get(name, factory)
        raise ValueError(
            f"planner {name!r} refuses its options: {error}; it takes {inspect.signature(accepted)}"
        ) from error
    return planner if isinstance(planner, Planner) else PlanOnly(planner.plan)
