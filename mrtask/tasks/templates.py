"""The six task templates of the paper (Section V), as co-safe formulas over distinct objects ``a`` to ``d``."""

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_lowercase

from mrtask.tasks.formula import check_names


@dataclass(frozen=True)
class Template:
    """A formula with ``{a}``, ``{b}``, ... for its ``arity`` objects."""

    name: str
    meaning: str
    arity: int
    text: str


TEMPLATES = {
    template.name: template
    for template in (
        Template("and2", "a and b", 2, "F {a} & F {b}"),
        Template("and3", "a, b and c", 3, "F {a} & F {b} & F {c}"),
        Template("and_or", "a, and b or c", 3, "F {a} & (F {b} | F {c})"),
        Template("seq2", "a then b", 2, "(!{b} U {a}) & F {b}"),
        Template("seq3", "a then b then c", 3, "((!{c} & !{b}) U {a}) & (!{c} U {b}) & F {c}"),
        # The paper's listing lacks the outer brackets; & binds tighter than |, and doing a alone would finish the task.
        Template(
            "or_seq",
            "a or b, then c, then d",
            4,
            "(((!{c} & !{d}) U {a}) | ((!{c} & !{d}) U {b})) & (!{d} U {c}) & F {d}",
        ),
    )
}


def make_formula(template: str, objects: Sequence[str]) -> str:
    """The formula of the template of that name for these objects, in the order a, b, c, d.

    Raises:
        ValueError: No such template, not as many objects as it takes, or a name twice or not fit for formulas.
    """
    if template not in TEMPLATES:
        raise ValueError(f"unknown template {template!r}; allowed: {', '.join(TEMPLATES)}")
    chosen = TEMPLATES[template]
    names = check_names(objects)
    if len(names) != chosen.arity:
        raise ValueError(
            f"template {template!r} ({chosen.meaning}) takes {chosen.arity} objects, not {len(names)}: "
            f"{', '.join(names) or 'none'}"
        )
    return chosen.text.format(**dict(zip(ascii_lowercase, names, strict=False)))
