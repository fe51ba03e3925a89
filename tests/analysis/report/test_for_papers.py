import re

import pytest
from markdown_it import MarkdownIt

from mrtask.analysis.page.exhibits import ShownTable
from mrtask.analysis.page.style import NOTHING
from mrtask.analysis.page.tables import ABOVE, Entry, Row, Table
from mrtask.analysis.report.for_papers import latex_table, latex_text, markdown_table, markdown_text

EVIL = (
    r"\input{x}", "100% of_it & #1 $y$ {z}", "~^", "a|b `c` *d* _e_ <script>alert(1)</script> &amp; [f](g:h) [i][j]",
    "two\nlines\r\nor\x85more", "\\", "a_b\\", "<br>",
)  # fmt: skip
TABLE = Table(
    (("small", "1 robot"), ("small", "2 robots"), ("", "why")),
    (
        Row("Mean cost in grid cells", heading=True),
        Row(
            "pouct",
            (
                Entry(f"12.5 % {ABOVE}", ("[1.0, 3.0]", "paper 2")),
                Entry(NOTHING, ("paper 3",)),
                Entry("x", tone="text"),
            ),
        ),
    ),
)
SHOWN = ShownTable("cost", "Costs", TABLE, "planner")


def test_latex_by_hand():
    assert latex_table(SHOWN) == (
        "% Costs\n"
        "% Needs \\usepackage{amssymb,booktabs}; names in scripts beyond Latin need XeLaTeX or LuaLaTeX.\n"
        "\\begin{tabular}{lrrl}\n"
        "\\toprule\n"
        " & \\multicolumn{2}{c}{small} &  \\\\\n"
        "planner & 1 robot & 2 robots & why \\\\\n"
        "\\midrule\n"
        "\\rlap{\\textit{Mean cost in grid cells}} &  &  &  \\\\\n"
        "pouct & 12.5 \\% $\\blacktriangle$ & -- & x \\\\\n"
        " & {\\footnotesize [1.0, 3.0]} & {\\footnotesize paper 3} &  \\\\\n"
        " & {\\footnotesize paper 2} &  &  \\\\\n"
        "\\bottomrule\n"
        "\\end{tabular}\n"
    )


def test_sentences_break_their_lines():
    long = Table((("", "a"), ("", "b")), (Row("r", (Entry("yes", ("because " * 10,)), Entry("1"))),))
    assert r"\begin{tabular}{lp{.28\linewidth}r}" in latex_table(ShownTable("t", "T", long, "c"))


def test_markdown_by_hand():
    lines = markdown_table(SHOWN).splitlines()
    assert lines[0] == "Costs" and lines[1] == ""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert cells[0] == ["planner", "small 1 robot", "small 2 robots", "why"]
    assert [cell.endswith(":") for cell in cells[1]] == [False, True, True, False]
    assert cells[2] == ["**Mean cost in grid cells**", "", "", ""]
    assert cells[3] == ["pouct", f"12.5 % {ABOVE} ([1.0, 3.0]; paper 2)", f"{NOTHING} (paper 3)", "x"]


def read_latex(text: str) -> str:
    """What LaTeX prints of text that only escapes; fails on any other command."""
    names = {"textbackslash{}": "\\", "textasciitilde{}": "~", "textasciicircum{}": "^"}
    pattern = re.compile(
        r"\\(textbackslash\{\}|textasciitilde\{\}|textasciicircum\{\}|[&%$#_{}])|\$([<>|])\$|([^\\&%$#_{}~^<>|])"
    )
    parts, place = [], 0
    while place < len(text):
        match = pattern.match(text, place)
        assert match, f"LaTeX reads {text[place:]!r} as a command"
        parts.append(names.get(match[1], match[1]) if match[1] else match[2] or match[3])
        place = match.end()
    return "".join(parts)


@pytest.mark.parametrize("text", EVIL)
def test_latex_shows_names_as_they_are(text):
    one_line = " ".join(text.splitlines())
    assert read_latex(latex_text(text)) == one_line
    table = Table((("", text), ("", "other")), (Row(text, (Entry(text, (text,)), Entry(text, tone="text"))),))
    source = latex_table(ShownTable("t", text, table, text))
    title, _, *rest = source.splitlines()
    assert title == f"% {one_line}" and rest[0].startswith("\\begin{tabular}") and rest[-1] == "\\end{tabular}"
    for line, expected in ((rest[2], [one_line, one_line, "other"]), (rest[4], [one_line] * 3)):
        assert [read_latex(cell) for cell in re.split(r" (?<!\\)& ", line.removesuffix(" \\\\"))] == expected


@pytest.mark.parametrize("text", EVIL)
def test_markdown_shows_names_as_they_are(text):
    one_line = " ".join(text.splitlines())
    reader = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])

    def words(tokens):
        """The text of inline tokens; anything but text would be markup that the name brought about."""
        assert {token.type for token in tokens} <= {"text", "text_special"}, tokens
        return "".join(token.content for token in tokens)

    table = Table((("", text),), (Row(text, (Entry(text, (text,)),)), Row("last", (Entry("1"),))))
    tokens = reader.parse(markdown_table(ShownTable("t", text, table, "c")))
    inline = [words(token.children) for token in tokens if token.type == "inline"]
    assert inline == [one_line, "c", one_line, one_line, f"{one_line} ({one_line})", "last", "1"]
    assert [words(token.children) for token in reader.parse(markdown_text(text)) if token.type == "inline"] == [
        one_line
    ]


def test_a_table_without_rows_or_with_a_name_twice():
    empty = ShownTable("t", "T", Table((("", "a"),), ()), "c")
    assert "\\toprule" in latex_table(empty) and "| a" in markdown_table(empty)
    twice = ShownTable("t", "T", Table((("", "a"), ("", "a")), (Row("r", (Entry("1"), Entry("2"))),)), "c")
    assert "c & a & a \\\\" in latex_table(twice) and "r & 1 & 2 \\\\" in latex_table(twice)
    assert markdown_table(twice).splitlines()[2].count("a") == 2
