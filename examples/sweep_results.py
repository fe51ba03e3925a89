"""Reads a sweep's Parquet files with pandas and with DuckDB.

The sweep: `python -m pipeline.evaluate -m experiment=smoke planner.pouct.samples=10,100 output_dir=outputs/sweep`;
then `python examples/sweep_results.py outputs/sweep`.
"""

import json
import sys
from pathlib import Path

import duckdb
import pandas as pd

SQL = """
    SELECT planner, size_class, count(*) AS episodes, avg(cost_cells) AS mean_cost_cells
    FROM read_parquet('{folder}/cells/*/episodes/*.parquet')
    WHERE status = 'accepted'
    GROUP BY ALL
    ORDER BY ALL
"""


def with_pandas(folder: Path) -> pd.DataFrame:
    """All episodes of the sweep with a column that says which cell they are of."""
    parts = []
    for manifest in sorted(folder.glob("cells/*/evaluation.json")):
        cell = json.loads(manifest.read_text())["sweep"]
        parts.append(pd.read_parquet(manifest.parent / "episodes").assign(sweep=cell))
    if not parts:
        raise SystemExit(f"no finished cells in {folder}; run the sweep above first")
    return pd.concat(parts, ignore_index=True)


def with_duckdb(folder: Path) -> pd.DataFrame:
    """The same files by SQL, without loading them."""
    return duckdb.sql(SQL.format(folder=folder)).df()


if __name__ == "__main__":
    where = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs/sweep")
    print(with_pandas(where).groupby(["sweep", "planner"]).cost_cells.mean().unstack().round(1))
    print(with_duckdb(where))
