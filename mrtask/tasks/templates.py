"""Task templates as co-safe formulas over distinct objects ``a`` to ``d``: the paper's six (Section V) and a few more.

The authors' public code has nine formulas instead of the six: `AUTHORS_TEMPLATES`. One of them orders three objects
without saying that c must not come before a. It is `seq3` nevertheless, because b must not come before a nor c before
b. A figure of the paper also has the four-object conjunction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_lowercase

from mrtask.tasks.formula import check_names, written


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
        Template("one", "a", 1, "F {a}"),
        Template("or2", "a or b", 2, "F {a} | F {b}"),
        Template("seq2_back", "b then a", 2, "(!{a} U {b}) & F {a}"),
        Template("and4", "a, b, c and d", 4, "F {a} & F {b} & F {c} & F {d}"),
    )
}

PAPER_TEMPLATES = ("and2", "and3", "and_or", "seq2", "seq3", "or_seq")
AUTHORS_TEMPLATES = ("one", "and2", "or2", "seq2", "seq2_back", "and3", "seq3", "and4", "or_seq")


def make_formula(template: str, objects: Sequence[str]) -> str:
    """Return the formula of the template of that name for these objects, in the order a, b, c, d.

    Raises:
        ValueError: The template is unknown, the number of objects is wrong, or a name is repeated or unfit for
            formulas.
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
    return chosen.text.format(**dict(zip(ascii_lowercase, map(written, names), strict=False)))
