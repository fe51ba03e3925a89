"""Lay out a task's automaton for drawing: states in layers from left to right, with the steps that advance the task.

Interactions that change nothing are left out, and so are those that would spoil the task, which no robot makes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np

from mrtask.tasks.automaton import Automaton

MAX_STATES = 40
"""Larger automata are clearer in words than in a drawing."""
RADIUS, ROW_GAP, MARGIN = 18.0, 74.0, 26.0
MIN_LAYER_GAP, CHAR_WIDTH = 110.0, 7.6
LABEL_AT = 0.42
"""Where on an edge its label stands: before the middle, where edges of one layer cross."""
ARROW = 7.0
BULGE = 0.22
"""How far an edge that passes a layer bends aside, relative to its length."""
MAX_NAMES = 3


@dataclass(frozen=True)
class StateNode:
    """A state at its place; ``left`` is the least number of interactions to acceptance."""

    state: int
    x: float
    y: float
    accepting: bool
    left: int


@dataclass(frozen=True)
class StateEdge:
    """A step: the SVG path of its line, and its label in lines around ``(x, y)``."""

    path: str
    lines: tuple[str, ...]
    x: float
    y: float


@dataclass(frozen=True)
class AutomatonDrawing:
    """Nodes and edges in a box of ``width`` by ``height``; y runs down."""

    width: float
    height: float
    nodes: tuple[StateNode, ...]
    edges: tuple[StateEdge, ...]


def draw_automaton(automaton: Automaton) -> AutomatonDrawing | None:
    """The drawing; None for an automaton of more than `MAX_STATES` states or one that nothing can satisfy."""
    if automaton.initial == automaton.sink:
        return None
    graph = _steps(automaton)
    if len(graph) > MAX_STATES:
        return None
    layers = _layers(graph, automaton.initial)
    labels = {(one, other): _label(names) for one, other, names in graph.edges(data="names")}
    widest = max((len(line) for lines in labels.values() for line in lines), default=0)
    gap = max(MIN_LAYER_GAP, CHAR_WIDTH * widest + 4 * RADIUS)
    rows, border = max(map(len, layers)), MARGIN + RADIUS
    places = {
        state: complex(border + depth * gap, border + ROW_GAP * (row + (rows - len(layer)) / 2))
        for depth, layer in enumerate(layers)
        for row, state in enumerate(layer)
    }
    edges = [
        _edge(places[one], places[other], lines, bent=abs((places[other] - places[one]).real) > 1.5 * gap)
        for (one, other), lines in labels.items()
    ]
    nodes = [
        StateNode(state, at.real, at.imag, bool(automaton.accepting[state]), int(automaton.steps_to_accept[state]))
        for state, at in places.items()
    ]
    width, height = 2 * border + gap * (len(layers) - 1), 2 * border + ROW_GAP * (rows - 1)
    return AutomatonDrawing(width, height, tuple(nodes), tuple(edges))


def _steps(automaton: Automaton) -> nx.DiGraph:
    """The states that advancing steps reach, with the objects of each step as the edges' ``names``."""
    graph = nx.DiGraph()
    graph.add_node(automaton.initial)
    for state, obj in np.argwhere(automaton.advancing).tolist():
        after = int(automaton.transitions[state, obj])
        names = graph.edges[state, after]["names"] if graph.has_edge(state, after) else []
        graph.add_edge(state, after, names=[*names, automaton.propositions[obj]])
    return graph.subgraph({automaton.initial, *nx.descendants(graph, automaton.initial)})


def _layers(graph: nx.DiGraph, initial: int) -> list[list[int]]:
    """States by layer, each layer in the order of the middles of its predecessors."""
    acyclic = nx.is_directed_acyclic_graph(graph)
    layers = list(map(list, nx.topological_generations(graph) if acyclic else nx.bfs_layers(graph, initial)))
    rank: dict[int, float] = {}
    for layer in layers:
        middle = {s: np.mean([rank[p] for p in graph.predecessors(s) if p in rank] or [0]) for s in layer}
        layer.sort(key=lambda state: (middle[state], state))
        rank |= {state: row - (len(layer) - 1) / 2 for row, state in enumerate(layer)}
    return layers


def _label(names: Sequence[str]) -> tuple[str, ...]:
    shown = list(names[:MAX_NAMES])
    if len(names) > MAX_NAMES:
        shown[-1] = f"{len(names) - MAX_NAMES + 1} others"
    return (shown[0], *(f"or {name}" for name in shown[1:]))


def _edge(start: complex, end: complex, lines: tuple[str, ...], bent: bool) -> StateEdge:
    """A line from border to border, bent where it would run through the states between; places are x + y i."""
    control = (start + end) / 2 - 1j * (end - start) * (BULGE if bent else 0)
    first, last = _towards(start, control, RADIUS), _towards(end, control, RADIUS + ARROW)
    t = LABEL_AT
    label = (1 - t) ** 2 * first + 2 * t * (1 - t) * control + t**2 * last
    return StateEdge(f"M{_xy(first)}Q{_xy(control)} {_xy(last)}", lines, label.real, label.imag)


def _towards(start: complex, target: complex, distance: float) -> complex:
    return start + distance * (target - start) / abs(target - start)


def _xy(place: complex) -> str:
    return f"{place.real:.1f} {place.imag:.1f}"
