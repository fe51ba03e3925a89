"""The common look of all figures and tables: labels, colours, markers, units.

Colours are Okabe and Ito's, which people with colour-vision deficiencies tell apart (https://jfly.uni-koeln.de/color/).
"""

import base64
import io
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from mrtask.planning.planners import PLANNERS

BLACK, GREY, LIGHT_GREY = "#222222", "#767676", "#d9d9d9"
ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#e69f00",
    "#56b4e9",
    "#009e73",
    "#f0e442",
    "#0072b2",
    "#d55e00",
    "#cc79a7",
)
ROBOT_COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, GREY)
"""By robot index, or by team size minus one; they repeat for larger teams."""
ROBOT_LINES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), "-.")
PLANNER_LOOKS = {
    "nonlearned_myopic": (GREY, "s"),
    "learned_myopic": (ORANGE, "D"),
    "greedy": (GREEN, "^"),
    "pouct_paper": (SKY, "v"),
    "pouct": (BLUE, "o"),
    "known": (BLACK, "*"),
}
"""``(colour, marker)`` where a planner has its own; every other planner gets the next of those below."""
OTHER_COLORS = (PURPLE, VERMILION, YELLOW)
OTHER_MARKERS = "PXph<>d"
PIXELS_PER_INCH = 150
PADDING_IN = 0.08
NOTHING = "\N{EN DASH}"
"""Shown where there is no value."""

RC: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8e8e8",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "figure.dpi": PIXELS_PER_INCH,
    "pdf.fonttype": 42,
    "svg.hashsalt": "mrtask",
    "text.parse_math": False,  # names in the data may hold a dollar sign
}


@contextmanager
def house_style() -> Iterator[None]:
    """Matplotlib settings for the figures made inside."""
    with mpl.rc_context(RC):
        yield


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure that is independent of pyplot's global state and laid out without overlaps."""
    figure = Figure(figsize=(width_in, height_in), layout=ConstrainedLayoutEngine(h_pad=PADDING_IN, w_pad=PADDING_IN))
    FigureCanvasAgg(figure)
    return figure


def planner_looks(planners: Sequence[str]) -> dict[str, tuple[str, str]]:
    """``(colour, marker)`` of each planner; the same in every figure for a planner of the table."""
    others = [name for name in dict.fromkeys([*PLANNERS, *planners]) if name not in PLANNER_LOOKS]
    found = PLANNER_LOOKS | {
        name: (OTHER_COLORS[index % len(OTHER_COLORS)], OTHER_MARKERS[index % len(OTHER_MARKERS)])
        for index, name in enumerate(others)
    }
    return {name: found[name] for name in planners}


def robot_color(index: int) -> str:
    """The colour of the robot with this index."""
    return ROBOT_COLORS[index % len(ROBOT_COLORS)]


def planner_label(planner: str) -> str:
    """A planner's name in figures and tables; of an import path, the last part."""
    return planner.rsplit(".", 1)[-1]


def seconds(value: float) -> str:
    """A duration in the unit that suits it."""
    if not math.isfinite(value):
        return NOTHING
    if value < 0.1:
        return f"{1000 * value:.3g} ms"
    if value < 120:
        return f"{value:.3g} s"
    minutes, rest = divmod(round(value), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def svg_bytes(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    return _saved(figure, format="svg", metadata={"Date": None, "Creator": None})


def data_uri(svg: bytes) -> str:
    """A picture for an ``<img>`` that loads nothing."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


def pdf_bytes(figure: Figure) -> bytes:
    """The figure as PDF with TrueType fonts, which publishers accept; the same bytes for the same figure."""
    return _saved(figure, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})


def _saved(figure: Figure, **options: Any) -> bytes:
    buffer = io.BytesIO()
    with house_style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # names in scripts that the font lacks
        figure.savefig(buffer, **options)
    figure.set_layout_engine("none")  # in the next format it stands as it does in this one, and that much sooner
    return buffer.getvalue()
