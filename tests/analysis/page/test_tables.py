import numpy as np
import pytest

from mrtask.analysis.page.tables import Column, Entry, block, estimate_entry, make_table
from mrtask.analysis.results.statistics import UNDEFINED, Estimate

ABOVE, BELOW, AROUND = Estimate(2.0, 1.0, 3.0, 20), Estimate(-2.0, -3.0, -1.0, 20), Estimate(0.5, -1.0, 2.0, 20)


@pytest.mark.parametrize(
    ("higher_is_better", "tones"),
    [(True, ("good", "bad", "")), (False, ("bad", "good", "")), (None, ("", "", ""))],
)
def test_estimates_are_coloured_by_what_is_better(higher_is_better, tones):
    column = Column[Estimate](lambda estimate: estimate, digits=2, unit=" %", higher_is_better=higher_is_better)
    entries = [column.entry(estimate) for estimate in (ABOVE, BELOW, AROUND)]
    assert tuple(entry.tone for entry in entries) == tones
    assert entries[1].value == "-2.00 %" and entries[1].details == ("[-3.0, -1.0]",)


def test_values_that_are_missing():
    estimates = Column[Estimate](lambda estimate: estimate, csv=("mean", "low", "high"))
    assert estimates.entry(UNDEFINED) == Entry("\N{EN DASH}")
    assert np.isnan(list(estimates.record(UNDEFINED).values())).all()
    assert Column[float](lambda value: value, unit=" s").entry(float("nan")).value == "\N{EN DASH}"


def test_record_names_each_part_of_an_estimate():
    column = Column[Estimate](lambda estimate: estimate, csv=("mean", "low", "high"))
    assert column.record(ABOVE) == {"mean": 2.0, "low": 1.0, "high": 3.0}
    with pytest.raises(ValueError, match="zip"):
        Column[Estimate](lambda estimate: estimate, csv=("mean",)).record(ABOVE)


def test_table_takes_headings_and_subjects():
    columns = [Column[int](lambda value: value, ("all", "number")), Column[int](lambda value: f"<{value}>")]
    table = make_table(columns, ["part", ("three", 3)])
    assert table.columns == (("all", "number"), ("", "")) and table.rows[0].heading
    assert table.rows[1].label == "three" and table.rows[1].entries == (Entry("3"), Entry("<3>"))


def test_an_estimate_with_its_interval():
    assert estimate_entry(ABOVE) == Entry("2.0 %", ("[1.0, 3.0]",))
    assert estimate_entry(ABOVE, 2, "", "+", False, 2) == Entry("+2.00", ("[1.00, 3.00]",), "bad")
    assert estimate_entry(Estimate(2.0, np.nan, np.nan, 4), higher_is_better=True) == Entry("2.0 %", ("n = 4",))


def test_a_block_without_rows_has_no_heading():
    assert block("part", []) == []
    heading, row = block("part", [("one", map(Entry, "ab"))])
    assert heading.heading and row.label == "one" and [entry.value for entry in row.entries] == ["a", "b"]
