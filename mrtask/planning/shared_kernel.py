"""The parts that the compiled searches of `pouct` and `pouct_paper` share: constants, task states and samples.

Legend: C containers, R robots. Sets of objects are bit masks.
"""

from typing import Protocol

import numpy as np

from mrtask.arrays import Floats, Ints
from mrtask.planning.compiled import Records, inlined

NONE = -1
"""No robot, container, object, node or edge."""
AUTOMATON = 0
"""The index of the automaton's state in a sample's ``state``."""

STATE = np.dtype(
    [
        ("advancing", np.int64),  # mask
        ("worth", np.int64),  # mask: advancing, and the task can finish without returning to this state
        ("nearer", np.int64),  # mask: advancing, and either safe or one interaction nearer to acceptance
        ("safe", np.int64),  # mask: advancing, and cannot hurt
        ("automatic", np.int64),  # mask: interactions taken without a decision
        ("needed", np.int64),  # mask: advancing now or later
        ("steps", np.int64),  # number of interactions to acceptance, with objects that can be found
        ("accepting", np.int64),
    ],
    align=True,
)


class Sample(Protocol):
    """The fields that `team_kernel.World` and the paper's `PaperBelief` have in common."""

    @property
    def clock(self) -> Floats:
        """[1] the seconds since the root."""

    @property
    def state(self) -> Ints:
        """The automaton's state, at AUTOMATON, and further numbers."""

    @property
    def containers(self) -> Records:
        """[C] records of the search's own type CONTAINER."""

    @property
    def nowhere(self) -> Floats:
        """[O] the probability that no container holds an object."""

    @property
    def robots(self) -> Records:
        """[R] records of the search's own type ROBOT, which has a field ``undecided``."""


@inlined
def copy_team(source: Sample, target: Sample) -> None:
    """Overwrite the target with the source."""
    target.clock[0] = source.clock[0]
    for i in range(source.state.size):
        target.state[i] = source.state[i]
    for c in range(source.containers.size):
        target.containers[c] = source.containers[c]
    for o in range(source.nowhere.size):
        target.nowhere[o] = source.nowhere[o]
    for r in range(source.robots.size):
        target.robots[r] = source.robots[r]


@inlined
def any_undecided(sample: Sample) -> bool:
    """Return whether any robot still needs an assignment at this instant."""
    for r in range(sample.robots.size):
        if sample.robots[r].undecided:
            return True
    return False
