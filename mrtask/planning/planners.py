"""The planners by name: what each one is, and how a configuration becomes a planner.

To add a planner, add an entry to `PLANNERS`; tables, figures and findings follow its role and its place there. Colours
are not in this table because they decide no result: `mrtask.analysis.page.style` has a default for every planner.

A user's own planner needs no entry. Wherever a planner's name is expected, you can give its import path instead: the
``package.module.name`` of a class or function that takes its options as keywords and returns a `Planner`.
"""

import inspect
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path

from mrtask.errors import InputError
from mrtask.names import suggest
from mrtask.planning.planner import Planner, PlanOnly, Plans

PAPERS_PLANNER = "pouct_paper"
"""The planner that the paper proposes, by our name for it."""


class Role(Enum):
    """The role of a planner in a comparison."""

    BASELINE = "baseline"
    """A baseline of the paper. The report gives every planner's improvement over it."""
    REFERENCE = "reference"
    """Another planner with which all others are compared."""
    OURS = "ours"
    """A planner under study. Users' own planners have this role."""
    BOUND = "bound"
    """A planner that knows more than a real one can. It shows how much could still be gained."""


@dataclass(frozen=True)
class PlannerEntry:
    """One planner of the table."""

    where: str
    """The planner's class, in this package. It is imported only when needed: compiled searches take a second."""
    role: Role
    published_as: str | None = None
    """Our name for the planner in the paper's table of results with which this one is compared, or None."""

    @property
    def planner(self) -> Callable[..., Planner]:
        """The planner's class, which takes the options as keywords."""
        return _imported(self.path)

    @property
    def path(self) -> str:
        """The import path of the class."""
        return f"{__package__}.{self.where}"


PLANNERS: Mapping[str, PlannerEntry] = {
    "nonlearned_myopic": PlannerEntry("myopic.NonlearnedMyopic", Role.BASELINE, published_as="nonlearned_myopic"),
    "learned_myopic": PlannerEntry("myopic.LearnedMyopic", Role.BASELINE, published_as="learned_myopic"),
    "greedy": PlannerEntry("greedy.Greedy", Role.REFERENCE),
    "pouct_paper": PlannerEntry("paper.planner.PaperPouct", Role.REFERENCE, published_as=PAPERS_PLANNER),
    "pouct": PlannerEntry("pouct.Pouct", Role.OURS, published_as=PAPERS_PLANNER),
    "known": PlannerEntry("known.Known", Role.BOUND),
}
"""The planners, from the simplest to the best informed. Rows and legends keep this order."""


def planner_role(name: str) -> Role:
    """Return the role of a planner. A planner that is not in the table is a user's own."""
    return PLANNERS[name].role if name in PLANNERS else Role.OURS


def planners_with_role(role: Role) -> tuple[str, ...]:
    """Return the planners of the table with this role, in the table's order."""
    return tuple(name for name, entry in PLANNERS.items() if entry.role is role)


def planners_in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Return each name once, in the table's order. Users' own planners follow by name, before the bounds."""
    present, bounds = set(names), planners_with_role(Role.BOUND)
    first = [name for name in PLANNERS if name in present and name not in bounds]
    last = [name for name in bounds if name in present]
    return (*first, *sorted(present - {*first, *last}), *last)


def published_counterpart(name: str) -> str | None:
    """Return the planner in the paper's table with which this one is compared.

    For a user's own planner, this is the one that the paper proposes. For a planner of ours without a counterpart, it
    is None.
    """
    return PLANNERS[name].published_as if name in PLANNERS else PAPERS_PLANNER


def check_planner_name(name: str) -> None:
    """Raise `InputError` where a name is neither one of ours nor an import path; this imports nothing."""
    if name not in PLANNERS and not name.rpartition(".")[0].strip("."):
        raise InputError(
            f"unknown planner {name!r}; {suggest(name, PLANNERS)}, or the import path of your own (package.module.name)"
        )


def make_planner(name: str, options: Mapping[str, object] | None = None) -> Planner:
    """Make the planner of that name or import path with the given options.

    Raises:
        InputError: the name is unknown, the import path leads to no planner, or the planner refuses the options.
    """
    check_planner_name(name)
    factory = PLANNERS[name].planner if name in PLANNERS else _imported(name)
    try:
        planner = factory(**(options or {}))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"planner {name!r} refuses its options: {error}; it takes {inspect.signature(factory)}"
        ) from error
    except Exception as error:
        raise InputError(f"planner {name!r} cannot be made: {_said(error)}") from error
    return _as_planner(planner, f"planner {name!r}")


def as_planner(planner: Plans | str) -> Planner:
    """Return the planner with defaults for what it lacks, or the planner of that name or import path.

    Raises:
        InputError: it has no method `plan`, or `make_planner` refuses the name.
    """
    return make_planner(planner) if isinstance(planner, str) else _as_planner(planner, repr(planner))


def planner_name(planner: Planner) -> str:
    """Return the planner's name among ours, or the import path of its class (``package.module.Class``)."""
    kind = type(getattr(planner.plan, "__self__", planner))  # for a `PlanOnly`, the class that it wraps
    path = f"{kind.__module__}.{kind.__qualname__}"
    return next((name for name, entry in PLANNERS.items() if entry.path == path), path)


def _as_planner(planner: Plans, called: str) -> Planner:
    if isinstance(planner, type):
        raise InputError(f"{called} is a class; call it to make a planner")
    if isinstance(planner, Planner):
        return planner
    if not callable(getattr(planner, "plan", None)):
        raise InputError(f"{called} has no method plan(problem, seed), which every planner needs")
    return PlanOnly(planner.plan)


def _imported(path: str) -> Callable[..., Planner]:
    module_name, _, attribute = path.rpartition(".")
    try:
        factory: Callable[..., Planner] = getattr(import_module(module_name), attribute)
    except Exception as error:  # importing runs the user's code, which may raise anything
        raise InputError(f"planner {path!r} cannot be imported: {_said(error)}") from error
    if not callable(factory):
        raise InputError(f"planner {path!r} is no class or function, but {factory!r}")
    return factory


def _said(error: Exception) -> str:
    """Return an exception's message, with its kind and the line that raised it where the message leaves them out."""
    if isinstance(error, (ImportError, AttributeError)):
        return str(error)
    if isinstance(error, SyntaxError):  # its message ends with the file and line
        return f"{type(error).__name__}: {error}"
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
