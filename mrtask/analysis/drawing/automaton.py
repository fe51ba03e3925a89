"""Lays out a task's automaton for drawing: states in layers from left to right, only the steps that advance the task.

Left out are interactions that change nothing and those that would spoil the task, which no robot makes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx

from mrtask.tasks.automaton import Automaton

MAX_STATES = 40
"""Larger automata say more in words than in a drawing."""
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
    labels = {(one, other): _label(data["names"]) for one, other, data in graph.edges(data=True)}
    widest = max((len(line) for lines in labels.values() for line in lines), default=0)
    gap = max(MIN_LAYER_GAP, CHAR_WIDTH * widest + 4 * RADIUS)
    rows = max(map(len, layers))
    places = {
        state: (MARGIN + RADIUS + depth * gap, MARGIN + RADIUS + ROW_GAP * (row + (rows - len(layer)) / 2))
        for depth, layer in enumerate(layers)
        for row, state in enumerate(layer)
    }
    depth_of = {state: depth for depth, layer in enumerate(layers) for state in layer}
    edges = [
        _edge(places[one], places[other], lines, abs(depth_of[other] - depth_of[one]) != 1)
        for (one, other), lines in labels.items()
    ]
    nodes = [
        StateNode(state, x, y, bool(automaton.accepting[state]), int(automaton.steps_to_accept[state]))
        for state, (x, y) in places.items()
    ]
    width = 2 * (MARGIN + RADIUS) + gap * (len(layers) - 1)
    return AutomatonDrawing(width, 2 * (MARGIN + RADIUS) + ROW_GAP * (rows - 1), tuple(nodes), tuple(edges))


def _steps(automaton: Automaton) -> nx.DiGraph:
    """The states that advancing steps reach, with the objects of each step."""
    graph = nx.DiGraph()
    graph.add_node(automaton.initial)
    waiting = [automaton.initial]
    for state in waiting:
        for obj, name in enumerate(automaton.propositions):
            if automaton.advancing[state, obj]:
                after = int(automaton.transitions[state, obj])
                if after not in graph:
                    waiting.append(after)
                if graph.has_edge(state, after):
                    graph.edges[state, after]["names"].append(name)
                else:
                    graph.add_edge(state, after, names=[name])
    return graph


def _layers(graph: nx.DiGraph, initial: int) -> list[list[int]]:
    """States by layer, each layer in the order of the middles of its predecessors."""
    if nx.is_directed_acyclic_graph(graph):
        layers = [list(layer) for layer in nx.topological_generations(graph)]
    else:
        layers = [list(layer) for layer in nx.bfs_layers(graph, initial)]
    rank = {state: 0.0 for state in layers[0]}
    for layer in layers[1:]:
        middle = {
            state: sum(known) / len(known)
            if (known := [rank[p] for p in graph.predecessors(state) if p in rank])
            else 0
            for state in layer
        }
        layer.sort(key=lambda state: (middle[state], state))
        rank |= {state: row - (len(layer) - 1) / 2 for row, state in enumerate(layer)}
    return layers


def _label(names: Sequence[str]) -> tuple[str, ...]:
    shown = list(names[:MAX_NAMES])
    if len(names) > MAX_NAMES:
        shown[-1] = f"{len(names) - MAX_NAMES + 1} others"
    return (shown[0], *(f"or {name}" for name in shown[1:]))


def _edge(start: tuple[float, float], end: tuple[float, float], lines: tuple[str, ...], bent: bool) -> StateEdge:
    """A line from border to border; bent where it would run through the states between."""
    (x0, y0), (x1, y1) = start, end
    length = math.hypot(x1 - x0, y1 - y0)
    side = BULGE * length if bent else 0.0
    control = ((x0 + x1) / 2 + side * (y1 - y0) / length, (y0 + y1) / 2 - side * (x1 - x0) / length)
    ax, ay = _towards(start, control, RADIUS)
    bx, by = _towards(end, control, RADIUS + ARROW)
    t = LABEL_AT
    x, y = (
        (1 - t) ** 2 * a + 2 * t * (1 - t) * c + t**2 * b for a, c, b in ((ax, control[0], bx), (ay, control[1], by))
    )
    path = f"M{ax:.1f} {ay:.1f}Q{control[0]:.1f} {control[1]:.1f} {bx:.1f} {by:.1f}"
    return StateEdge(path, lines, x, y)


def _towards(start: tuple[float, float], target: tuple[float, float], distance: float) -> tuple[float, float]:
    dx, dy = target[0] - start[0], target[1] - start[1]
    length = math.hypot(dx, dy)
    return start[0] + distance * dx / length, start[1] + distance * dy / length
