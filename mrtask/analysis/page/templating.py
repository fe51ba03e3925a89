"""The templates of the pages that the analysis writes; values in them are escaped."""

import base64
import hashlib
from functools import cache
from importlib import resources

import jinja2
from markupsafe import Markup


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
    """What a page's policy names to let this script run and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def template_text(name: str) -> str:
    """A file of the templates as it is: a script or a style sheet of our own."""
    return resources.files("mrtask.analysis.page").joinpath("templates", name).read_text(encoding="utf-8")
