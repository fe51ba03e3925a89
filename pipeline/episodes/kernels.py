"""Compiles the planners' kernels, several at once, unless an earlier run has left them."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from mrtask.planning.planners import PLANNERS
from mrtask.planning.warm_up import Compilation, kernels_missing
from pipeline.base import console
from pipeline.base.specs import PlannerSpec


@contextmanager
def compiled_meanwhile(planners: Iterable[PlannerSpec]) -> Iterator[None]:
    """Compile what the planners need in other processes while the context runs, and wait for them at its end.

    A user's own planner compiles where it plans.
    """
    ours = {spec.name: (spec.planner, spec.options) for spec in planners if spec.planner in PLANNERS}
    if not ours or not kernels_missing():
        yield
        return
    with Compilation(ours) as compilation:
        yield
        began_s = time.monotonic()
        with console.Progress(len(ours), "planners compiled") as progress:
            for name, error in compilation.finished():
                progress.update()
                if error:  # the run continues: these episodes become rows of status error
                    console.line(f"{name} could not be compiled: {error}")
        console.line(
            f"planners compiled, once for this code ({console.duration(time.monotonic() - began_s)} of waiting)"
        )
