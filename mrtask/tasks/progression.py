"""Formula progression: what remains of a co-safe formula after a letter (Bacchus and Kabanza, 2000).

A letter is the set of the propositions that hold in it; the empty one is anything that makes none of them true.
The rest is a positive Boolean function of *atoms*: propositions, negated propositions, ``X`` and ``U`` formulas. It is
kept as a reduced ordered binary decision diagram (Bryant, 1986) over the atoms in order of appearance. Equal functions
are one node, whose successors are computed once however many states contain it. Wide alternations such as ``((F a | F
b) & (F c | F d) & ...) | F e`` therefore stay small, whereas sets of clauses multiply them out.
"""

from functools import reduce
from typing import NamedTuple

from mrtask.errors import InputError
from mrtask.tasks.formula import And, Constant, Formula, Next, Not, Or, Proposition, Until

Letter = frozenset[str]
"""The names of the propositions that hold."""
State = int
"""A node's index."""
FALSE: State = 0
TRUE: State = 1

MAX_ATOMS = 500
"""The largest number of different ``X`` and ``U`` subformulas. Each is a level of a diagram's recursion; this is well
inside Python's limit."""
MAX_NODES = 500_000
"""The largest number of nodes of all states together; reaching it takes seconds."""


class FormulaTooLargeError(InputError):
    """The formula has more different parts, or larger states, than progression handles."""


class _Node(NamedTuple):
    """``if atom then high else low``. Both are older nodes (with a smaller index) and belong to later atoms."""

    atom: int
    high: State
    low: State


class Progression:
    """The states of formulas given with their negations pushed inward (see ``push_negations``)."""

    def __init__(self) -> None:
        self._atoms: list[Formula] = []
        self._atom_index: dict[Formula, int] = {}
        # The constants come after all atoms.
        self._nodes = [_Node(MAX_ATOMS, FALSE, FALSE), _Node(MAX_ATOMS, TRUE, TRUE)]
        self._node_index: dict[_Node, State] = {}
        self._chosen: dict[tuple[State, State, State], State] = {}
        self._after: dict[Letter, dict[State, State]] = {}
        self._atom_after: dict[tuple[int, Letter], State] = {}

    def state(self, formula: Formula) -> State:
        """Return the state in which ``formula`` remains.

        Raises:
            FormulaTooLargeError: The formula has more than ``MAX_ATOMS`` different parts.
        """
        match formula:
            case Constant(value):
                return TRUE if value else FALSE
            case And(operands):
                return self._conjoin([self.state(operand) for operand in operands])
            case Or(operands):
                return self._disjoin([self.state(operand) for operand in operands])
            case _:
                return self._node(_Node(self._atom(formula), TRUE, FALSE))

    def after(self, state: State, letter: Letter) -> State:
        """Return the state after one more letter.

        Raises:
            FormulaTooLargeError: There are more than ``MAX_NODES`` nodes.
        """
        after = self._after.setdefault(letter, {FALSE: FALSE, TRUE: TRUE})
        unknown: set[State] = set()
        pending = [state]
        while pending:
            index = pending.pop()
            if index not in after and index not in unknown:
                unknown.add(index)
                pending += self._nodes[index][1:]
        for index in sorted(unknown):
            atom, high, low = self._nodes[index]
            if (atom, letter) not in self._atom_after:
                self._atom_after[atom, letter] = self._formula_after(self._atoms[atom], letter)
            after[index] = self._choose(self._atom_after[atom, letter], after[high], after[low])
        return after[state]

    def _formula_after(self, formula: Formula, letter: Letter) -> State:
        match formula:
            case Constant(value):
                return TRUE if value else FALSE
            case Proposition(name):
                return TRUE if name in letter else FALSE
            case Not(operand):
                return FALSE if self._formula_after(operand, letter) else TRUE
            case And(operands):
                return self._conjoin([self._formula_after(operand, letter) for operand in operands])
            case Or(operands):
                return self._disjoin([self._formula_after(operand, letter) for operand in operands])
            case Next(operand):
                return self.state(operand)
            case Until(left, right):
                still = self._conjoin([self._formula_after(left, letter), self.state(formula)])
                return self._disjoin([self._formula_after(right, letter), still])
            case _:
                raise TypeError(f"{formula} is not in the form that push_negations gives")

    def _conjoin(self, states: list[State]) -> State:
        return reduce(lambda rest, one: self._choose(one, rest, FALSE), reversed(states), TRUE)

    def _disjoin(self, states: list[State]) -> State:
        return reduce(lambda rest, one: self._choose(one, TRUE, rest), reversed(states), FALSE)

    def _choose(self, test: State, then: State, otherwise: State) -> State:
        """Return ``if test then ... else ...``, Bryant's ite."""
        if test == TRUE or then == otherwise:
            return then
        if test == FALSE:
            return otherwise
        if then == TRUE and otherwise == FALSE:
            return test
        key = (test, then, otherwise)
        if key not in self._chosen:
            first = min(self._nodes[state].atom for state in key)
            high = self._choose(*(self._assume(state, first, True) for state in key))
            low = self._choose(*(self._assume(state, first, False) for state in key))
            self._chosen[key] = high if high == low else self._node(_Node(first, high, low))
        return self._chosen[key]

    def _assume(self, state: State, atom: int, holds: bool) -> State:
        """Return the state if ``atom``, at or before the state's first, holds or does not."""
        node = self._nodes[state]
        if node.atom != atom:
            return state
        return node.high if holds else node.low

    def _node(self, node: _Node) -> State:
        if node not in self._node_index:
            if len(self._nodes) == MAX_NODES:
                raise FormulaTooLargeError(f"its states have more than {MAX_NODES} decision nodes")
            self._node_index[node] = len(self._nodes)
            self._nodes.append(node)
        return self._node_index[node]

    def _atom(self, formula: Formula) -> int:
        if formula not in self._atom_index:
            if len(self._atoms) == MAX_ATOMS:
                raise FormulaTooLargeError(f"it has more than {MAX_ATOMS} different parts")
            self._atom_index[formula] = len(self._atoms)
            self._atoms.append(formula)
        return self._atom_index[formula]
