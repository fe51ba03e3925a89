"""Named tables and pictures, which a section of the report shows and which lie as files for papers beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from markupsafe import Markup
from matplotlib.figure import Figure

from mrtask.analysis.page.style import data_uri, pdf_bytes, svg_bytes
from mrtask.analysis.page.tables import Table

TABLES, FIGURES = "tables", "figures"
"""The folders beside the page."""


@dataclass(frozen=True)
class ShownTable:
    """A table in its place on the page."""

    name: str
    """The name of its files, without folder and ending."""
    title: str
    """Its title, for readers who see only the file."""
    table: Table
    corner: str
    """The heading of the rows' labels."""
    wide: bool = False

    @property
    def files(self) -> tuple[tuple[str, str], ...]:
        """``(label, path from the page)`` of each file."""
        return ("LaTeX", f"{TABLES}/{self.name}.tex"), ("Markdown", f"{TABLES}/{self.name}.md")


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption, which is also its text for those who cannot see it."""

    name: str
    """The name of its files, without folder and ending."""
    title: str
    caption: str
    figure: Figure

    @cached_property
    def svg(self) -> bytes:
        """The figure as the page shows it."""
        return svg_bytes(self.figure)

    @property
    def pdf(self) -> bytes:
        """The figure for papers."""
        return pdf_bytes(self.figure)

    @property
    def uri(self) -> str:
        """The picture itself, for an ``<img>``."""
        return data_uri(self.svg)

    @property
    def files(self) -> tuple[tuple[str, str], ...]:
        """``(label, path from the page)`` of each file."""
        return (("SVG", f"{FIGURES}/{self.name}.svg"),)

    @property
    def pdf_file(self) -> str:
        """The path from the page of the figure for papers, which is drawn on request."""
        return f"{FIGURES}/{self.name}.pdf"


@dataclass(frozen=True)
class Content:
    """A section's content: its HTML, and the tables and pictures in it."""

    html: Markup
    tables: Sequence[ShownTable] = ()
    pictures: Sequence[Picture] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Other files beside the page: path -> content."""
    in_short: str = ""
    """A sentence for the page's answer, with a link to the section."""
