"""The minimal automaton of a task: which interactions advance it, which spoil it, and when it is done.

A run's word has one letter per completed interaction. A state accepts if every continuation satisfies the formula,
whatever happens later: any infinite sequence of letters, each an interaction with one of the propositions or with *none
of them* (another object, or nothing ever again). The latter matters: a team that can interact with nothing but ``a``
has not done ``F a`` before it has done ``a``. Formulas are read over infinite words, so ``X true`` is ``true``.
"""

from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mrtask.arrays import Bools, Int32s
from mrtask.tasks.formula import Formula, FormulaError, check_names, parse, proposition_names, push_negations
from mrtask.tasks.progression import TRUE, FormulaTooLargeError, Progression, State

MAX_STATES = 10_000
NEVER_ACCEPTS = 2**30
"""The sink's entry in ``steps_to_accept``. It is larger than any number of letters, and two of them still fit in
int32."""
_ROWS_PER_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Automaton:
    """A task's deterministic automaton (legend: Z states, O propositions), minimal over sequences of the propositions.

    Every letter of an accepting state leads back to it, so there is at most one. ``initial == sink`` for a formula that
    no sequence of the propositions can satisfy. States are numbered breadth first, in the order of the propositions.
    """

    formula: str
    propositions: tuple[str, ...]
    transitions: Int32s
    """``[Z, O]``: the state after the interaction."""
    accepting: Bools
    """``[Z]``"""
    sink: int
    """The state from which acceptance cannot be reached; -1 if every state can reach it."""
    initial: int

    @cached_property
    def advancing(self) -> Bools:
        """Return ``[Z, O]``, W(z): the propositions that lead to another state from which acceptance can be reached."""
        itself = np.arange(len(self.transitions))[:, None]
        advancing: Bools = (self.transitions != itself) & (self.transitions != self.sink)
        return advancing

    @cached_property
    def steps_to_accept(self) -> Int32s:
        """Return ``[Z]``: the least number of letters to an accepting state, or ``NEVER_ACCEPTS`` for the sink."""
        return _steps_to_accept(self.transitions, self.accepting)

    def steps_with(self, available: Bools) -> Int32s:
        """Return ``[Z]``: like ``steps_to_accept``, but only with letters of the ``available`` ``[O]`` propositions."""
        return _steps_to_accept(self.transitions[:, available], self.accepting)

    @cached_property
    def includes(self) -> Bools:
        """Return ``[Z, Z]``: ``includes[a, b]`` if every word that finishes the task from ``b`` does so from ``a``."""
        # The greatest fixed point over the letters, from a necessary condition that leaves few pairs. It works in
        # blocks of rows, because lists of all pairs would take far more memory than the result.
        steps = self.steps_to_accept
        includes = steps[:, None] <= steps[None, :]
        shrunk = True
        while shrunk:
            shrunk = False
            for first in range(0, len(includes), _ROWS_PER_BLOCK):
                ones, others = np.nonzero(includes[first : first + _ROWS_PER_BLOCK])
                ones += first
                pairs_before = len(ones)
                for successors in self.transitions.T:
                    kept = includes[successors[ones], successors[others]]
                    includes[ones[~kept], others[~kept]] = False
                    ones, others = ones[kept], others[kept]
                shrunk |= len(ones) < pairs_before
        return includes

    def run(self, letters: Iterable[str], start: int | None = None) -> int:
        """Return the state after a sequence of interactions from ``start`` (by default the initial state).

        Raises:
            ValueError: A letter is not one of the propositions.
        """
        state = self.initial if start is None else start
        for letter in letters:
            if letter not in self.propositions:
                raise ValueError(f"no proposition {letter!r} in this task; it has: {', '.join(self.propositions)}")
            state = int(self.transitions[state, self.propositions.index(letter)])
        return state

    def to_dot(self) -> str:
        """Return the automaton in Graphviz's language: accepting states have a double line, the sink is grey."""
        lines = [
            "digraph task {",
            f"  label={_dot_text(' '.join(self.formula.split()))}; labelloc=t; rankdir=LR;",
            '  start [shape=point, label=""];',
        ]
        for state, accepts in enumerate(self.accepting):
            style = ", color=gray" if state == self.sink else ""
            lines.append(f"  {state} [shape={'doublecircle' if accepts else 'circle'}{style}];")
        lines.append(f"  start -> {self.initial};")
        for state, successors in enumerate(self.transitions):
            for successor in dict.fromkeys(successors.tolist()):
                names = [name for name, to in zip(self.propositions, successors, strict=True) if to == successor]
                lines.append(f"  {state} -> {successor} [label={_dot_text(', '.join(names))}];")
        return "\n".join([*lines, "}"]) + "\n"


def build_automaton(
    formula: str, propositions: Collection[str] | None = None, max_states: int = MAX_STATES
) -> Automaton:
    """Build the minimal automaton of a co-safe formula.

    Args:
        formula: The task; see ``mrtask.tasks.formula`` for the grammar.
        propositions: The objects a run can interact with, in the order of the automaton's columns (a set is sorted);
            ``None`` takes the formula's, in order of appearance.
        max_states: The most states to explore before minimisation.

    Raises:
        FormulaError: The formula has a syntax error, an unknown object, or is not co-safe.
        FormulaTooLargeError: There are more than ``max_states`` states, or they are larger than progression handles.
        ValueError: An object's name cannot be used in formulas.
    """
    if max_states < 1:
        raise ValueError(f"max_states must be at least 1, not {max_states}")
    declared = None if propositions is None else check_names(propositions)
    parsed = parse(formula, declared)
    letters = proposition_names(parsed)
    try:
        graph, accepting = _explore(parsed, letters, max_states)
    except FormulaTooLargeError as error:
        message = f"the automaton of {formula!r} is too large: {error}; simplify the formula"
        raise FormulaTooLargeError(message) from None
    except _TooManyStatesError:
        raise FormulaTooLargeError(
            f"the automaton of {formula!r} is too large: it has more than max_states={max_states} states before "
            "minimisation; simplify the formula or raise max_states"
        ) from None
    names = letters if declared is None else declared
    columns = [letters.index(name) if name in letters else len(letters) for name in names]
    transitions, accepting = _minimised(graph[:, columns], accepting)
    doomed = np.flatnonzero(_steps_to_accept(transitions, accepting) == NEVER_ACCEPTS)
    return Automaton(
        formula=formula,
        propositions=names,
        transitions=transitions,
        accepting=accepting,
        sink=int(doomed[0]) if len(doomed) else -1,
        initial=0,
    )


def check_task(automaton: Automaton) -> Automaton:
    """Return the automaton of a task that somebody has to do something for, and can do.

    Raises:
        FormulaError: No order of interactions with its propositions satisfies the formula, or every one does.
    """
    if automaton.initial == automaton.sink:
        raise FormulaError(
            "no order of interactions does this task; an interaction is with one object at a time, so for both of two "
            "objects write 'F a & F b', not 'F (a & b)'",
            automaton.formula,
            1,
        )
    if automaton.accepting[automaton.initial]:
        raise FormulaError(
            "this task is done before anything is done; say what to interact with, as in 'F a'", automaton.formula, 1
        )
    return automaton


def _dot_text(text: str) -> str:
    """Return a text as Graphviz's language quotes it."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


class _TooManyStatesError(Exception):
    """Exploration found more states than allowed."""


def _explore(formula: Formula, letters: tuple[str, ...], max_states: int) -> tuple[Int32s, Bools]:
    """Return the S states that progression reaches, starting with the formula itself.

    These are the successors ``[S, len(letters) + 1]`` after each letter and, in the last column, after none of them;
    and whether each state accepts ``[S]``.
    """
    progression = Progression()
    numbers: dict[State, int] = {}
    queue: deque[State] = deque()

    def number(state: State) -> int:
        if state not in numbers:
            if len(numbers) == max_states:
                raise _TooManyStatesError
            numbers[state] = len(numbers)
            queue.append(state)
        return numbers[state]

    number(progression.state(push_negations(formula)))
    rows = []
    while queue:
        state = queue.popleft()
        rows.append([number(progression.after(state, letter)) for letter in (*letters, None)])
    graph = np.array(rows, dtype=np.int32)

    # A formula that is certain to be satisfied is true after a bounded number of letters, whichever they are
    # (König's lemma).
    accepting = np.array([state == TRUE for state in numbers])
    while True:
        extended = accepting | accepting[graph].all(axis=1)
        if (extended == accepting).all():
            return graph, accepting
        accepting = extended


def _minimised(graph: Int32s, accepting: Bools) -> tuple[Int32s, Bools]:
    """Apply Moore's partition refinement to the graph ``[S, O]``.

    Return the blocks that state 0 reaches, breadth first.
    """
    block = accepting.astype(np.intp)
    count = len(np.unique(block))
    while True:
        signatures = np.column_stack([block, block[graph]])
        _, members, block = np.unique(signatures, axis=0, return_index=True, return_inverse=True)
        if len(members) == count:
            break
        count = len(members)
    order = [int(block[0])]
    seen = set(order)
    successors = block[graph[members]].tolist()
    for one in order:
        for successor in successors[one]:
            if successor not in seen:
                seen.add(successor)
                order.append(successor)
    number = np.full(count, -1, dtype=np.int32)
    number[order] = np.arange(len(order))
    kept = members[order]
    return np.ascontiguousarray(number[block[graph[kept]]]), accepting[kept]


def _steps_to_accept(transitions: Int32s, accepting: Bools) -> Int32s:
    steps = np.where(accepting, 0, NEVER_ACCEPTS).astype(np.int32)
    while True:
        through_next = steps[transitions].min(axis=1, initial=NEVER_ACCEPTS - 1) + 1
        nearer: Int32s = np.minimum(steps, through_next).astype(np.int32)
        if (nearer == steps).all():
            return steps
        steps = nearer
