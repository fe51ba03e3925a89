"""Generated against real homes, in small: the tables, and what is refused."""

import gzip
import json
from pathlib import Path

import pandas as pd
import pytest

from mrtask.analysis.studies.realism import KINDS, NUMBERS
from mrtask.homes.generator.house import generate_house
from tests.pipeline.harness import Cli


@pytest.fixture
def overrides(tmp_path: Path) -> tuple[str, ...]:
    """ "Real" homes that the generator made, too, from other seeds."""
    houses = [generate_house(seed, size_class) for seed in range(900, 908) for size_class in ("small", "medium")]
    lines = "".join(json.dumps(house) + "\n" for house in houses)
    (tmp_path / "real.jsonl.gz").write_bytes(gzip.compress(lines.encode()))
    counts = ("homes.train=6", "homes.validation=2", "homes.test=null", "realism.generated_test=4")
    return ("homes=procthor", "homes.files=[real.jsonl.gz]", *counts, "map.resolution_m=0.1")


def test_both_tables(cli: Cli, tmp_path: Path, overrides: tuple[str, ...]) -> None:
    done = cli("realism", *overrides, "realism.models=[frequency]", "draw=true")
    assert done.code == 0, done.err
    assert "12 generated homes against 16 real ones" in done.out
    assert "models tested on 8 real homes" in done.out
    folder = tmp_path / "outputs" / "paper" / "realism"
    homes = pd.read_csv(folder / "homes.csv")
    assert set(homes["size_class"]) == {"small", "medium"}
    assert len(homes) == 2 * (len(NUMBERS) + len(KINDS))
    assert homes[["distance", "yardstick"]].stack().between(0, 1).all()
    assert (folder / "gallery.png").stat().st_size > 10_000
    transfer = pd.read_csv(folder / "transfer.csv")
    assert list(transfer["trained_on"]) == ["generated", "real"]
    assert set(transfer["training_homes"]) == {6}
    assert transfer["roc_auc"].between(0.7, 1).all()
    assert (transfer["log_loss"] > transfer["best_log_loss"]).all()
    again = cli("realism", *overrides, "realism.models=[]")
    assert again.code == 0
    assert again.out.count("(unchanged, skipped)") == 2
    pd.testing.assert_frame_equal(pd.read_csv(folder / "homes.csv"), homes)


def test_homes_are_measured_on_the_configured_ways(cli: Cli, tmp_path: Path, overrides: tuple[str, ...]) -> None:
    tables = []
    for ways in ("shortest", "soft"):
        done = cli("realism", *overrides, "realism.models=[]", f"map.ways={ways}", f"output_dir={ways}")
        assert done.code == 0, done.err
        tables.append(pd.read_csv(tmp_path / ways / "realism" / "homes.csv"))
    assert not tables[0].equals(tables[1])


def test_generated_homes_are_not_compared_with_themselves(cli: Cli) -> None:
    done = cli("realism")
    assert done.code == 2
    assert "homes=generated: real homes are needed to compare with; give homes=procthor" in done.err
