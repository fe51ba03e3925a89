"""A page that answers a question: its findings, then its sections. Values in the templates are escaped."""

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import jinja2
from markupsafe import Markup

from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.tables import Table


@dataclass(frozen=True)
class Findings:
    """``verdict`` answers in a word or two, ``headline`` in a sentence; the rest adds detail and caution."""

    verdict: str
    headline: str
    sentences: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class PageSection:
    """A heading with what stands below it."""

    anchor: str
    title: str
    body: Markup
    link: str = ""
    """The entry in the navigation; by default the title."""
    in_short: str = ""
    """A sentence for the page's answer, with a link to the section."""


def render_page(
    title: str,
    question: str,
    findings: Findings,
    sections: Sequence[PageSection],
    episodes: int,
    *,
    warnings: Sequence[str] = (),
    variants: Sequence[str] = (),
    script: str = "",
) -> str:
    """The HTML page: the answer, then the sections.

    Args:
        episodes: how many the page is made from.
        variants: of a sweep, of which the page shows the last in full.
        script: the one script that the page may run.
    """
    return render_fragment(
        "page",
        title=title,
        question=question,
        findings=findings,
        sections=sections,
        episodes=episodes,
        warnings=warnings,
        variants=variants,
        script=Markup(script),
        script_digest=script_digest(script),
    )


def study_section(
    anchor: str,
    title: str,
    tables: Sequence[Table] = (),
    corner: str = "",
    note: str = "",
    pictures: Sequence[Picture] = (),
    facts: Sequence[tuple[str, str]] = (),
) -> PageSection:
    """A section of pictures, tables, a note and facts; ``corner`` is the heading of the tables' first column."""
    body = render_fragment("study", tables=tables, corner=corner, note=note, pictures=pictures, facts=facts)
    return PageSection(anchor, title, body)


@cache
def templates() -> jinja2.Environment:
    """The environment of ``mrtask/analysis/page/templates``."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("mrtask.analysis.page"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render_fragment(template: str, **values: object) -> Markup:
    """The HTML of ``templates/<template>.html.jinja``."""
    return Markup(templates().get_template(f"{template}.html.jinja").render(values))


def script_digest(script: str) -> str:
    """The digest by which a page's security policy allows this script and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def template_text(name: str) -> str:
    """The text of a script or style sheet among the templates."""
    return resources.files("mrtask.analysis.page").joinpath("templates", name).read_text(encoding="utf-8")
