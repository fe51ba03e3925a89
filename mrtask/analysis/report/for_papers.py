"""The report's tables in the formats that papers need: LaTeX with booktabs' rules, and Markdown.

Names come from the data, so everything that LaTeX or Markdown would read as a command is escaped.
"""

import re
from collections.abc import Sequence

import pandas as pd

from mrtask.analysis.page.exhibits import Content, ShownTable
from mrtask.analysis.page.style import NOTHING
from mrtask.analysis.page.tables import ABOVE, BELOW, LEVEL, Entry, Table

LATEX_SIGNS = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "|": "$|$",
        ABOVE: r"$\blacktriangle$",
        BELOW: r"$\blacktriangledown$",
        LEVEL: r"$\approx$",
        NOTHING: "--",
        "\N{NO-BREAK SPACE}": "~",
    }
)
"""What LaTeX reads as a command, and signs that its own fonts have only in mathematics or under another name."""
LATEX_NEEDS = r"% Needs \usepackage{amssymb,booktabs}; names in scripts beyond Latin need XeLaTeX or LuaLaTeX."
MAX_UNBROKEN_CHARS = 60
MARKDOWN_SIGNS = re.compile(r"[\\`*_<>|~&$]|\](?=[(\[])")
"""What Markdown would read as code, emphasis, HTML, an entity, mathematics, a column, or the end of a link's text."""


def paper_files(contents: Sequence[Content], pdf: bool = False) -> dict[str, bytes]:
    """Path beside the page -> content, for every table, picture (also as ``pdf``) and other file of the sections."""
    files: dict[str, bytes] = {}
    for content in contents:
        files |= {path: text.encode() for path, text in content.files.items()}
        for table in content.tables:
            texts = (latex_table(table), markdown_table(table))
            files |= {path: text.encode() for (_, path), text in zip(table.files, texts, strict=True)}
        for picture in content.pictures:
            files |= {path: picture.svg for _, path in picture.files}
            if pdf:
                files[picture.pdf_file] = picture.pdf
    return files


def latex_table(shown: ShownTable) -> str:
    """A ``tabular``; the details below a value get a line of their own in smaller type."""
    table = shown.table
    headings = [(latex_text(upper), latex_text(lower)) for upper, lower in (("", shown.corner), *table.columns)]
    two = any(upper for upper, _ in headings)
    columns = pd.MultiIndex.from_tuples(headings) if two else pd.Index([lower for _, lower in headings])
    frame = pd.DataFrame(_latex_lines(table), columns=columns, dtype="str")
    sides = [_latex_side([row.label for row in table.rows if not row.heading], words=True)]
    for index in range(len(table.columns)):
        entries = [row.entries[index] for row in table.rows if not row.heading]
        texts = [text for entry in entries for text in (entry.value, *entry.details)]
        sides.append(_latex_side(texts, _is_text(table, index)))
    tabular = frame.style.hide(axis="index").to_latex(column_format="".join(sides), hrules=True, multicol_align="c")
    return f"% {_in_line(shown.title)}\n{LATEX_NEEDS}\n{tabular}"


def latex_text(text: str) -> str:
    """Running text, or a cell, for LaTeX."""
    return _in_line(text).translate(LATEX_SIGNS)


def markdown_table(shown: ShownTable) -> str:
    """A pipe table below its title; the details below a value follow it in brackets."""
    table = shown.table
    lines = [
        [f"**{markdown_text(row.label)}**", *[""] * len(table.columns)]
        if row.heading
        else [
            markdown_text(row.label),
            *(markdown_text(_with_details(entry)) for entry in row.entries),
        ]
        for row in table.rows
    ]
    headings = [shown.corner, *(f"{upper} {lower}".strip() for upper, lower in table.columns)]
    sides = ["left", *("left" if _is_text(table, index) else "right" for index in range(len(table.columns)))]
    frame = pd.DataFrame(lines, columns=list(map(markdown_text, headings)))
    text = frame.to_markdown(index=False, disable_numparse=True, colalign=sides if lines else None)
    return f"{markdown_text(shown.title)}\n\n{text}\n"


def markdown_text(text: str) -> str:
    """Running text, or a cell, for Markdown."""
    return MARKDOWN_SIGNS.sub(r"\\\g<0>", _in_line(text))


def _latex_lines(table: Table) -> list[list[str]]:
    r"""The cells line by line; a heading reaches over the empty cells to its right without widening its column."""
    lines: list[list[str]] = []
    for row in table.rows:
        if row.heading:
            lines.append([rf"\rlap{{\textit{{{latex_text(row.label)}}}}}", *[""] * len(table.columns)])
            continue
        lines.append([latex_text(row.label), *(latex_text(entry.value) for entry in row.entries)])
        for level in range(max((len(entry.details) for entry in row.entries), default=0)):
            below = (entry.details[level] if level < len(entry.details) else "" for entry in row.entries)
            lines.append(["", *(rf"{{\footnotesize {latex_text(detail)}}}" if detail else "" for detail in below)])
    return lines


def _latex_side(texts: Sequence[str], words: bool) -> str:
    """The alignment of a column; one with sentences in it breaks its lines."""
    if max(map(len, texts), default=0) > MAX_UNBROKEN_CHARS:
        return r"p{.28\linewidth}"
    return "l" if words else "r"


def _with_details(entry: Entry) -> str:
    """A value, followed by its details in brackets."""
    details = "; ".join(detail for detail in entry.details if detail)
    return f"{entry.value} ({details})" if details else entry.value


def _is_text(table: Table, column: int) -> bool:
    """Whether a column holds words, which are aligned to the left."""
    return any(row.entries[column].tone == "text" for row in table.rows if not row.heading)


def _in_line(text: str) -> str:
    """Without line breaks, which would end a comment, a cell or a row."""
    return " ".join(text.splitlines())
