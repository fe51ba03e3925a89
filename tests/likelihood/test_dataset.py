"""The dataset: what is written is read, what is damaged is refused, no home is on two sides."""

import json

import numpy as np
import pandas as pd
import pytest

from mrtask.likelihood.dataset import (
    Dataset,
    DatasetError,
    build_dataset,
    inputs_hash,
    is_current,
    read_dataset,
    read_manifest,
    write_dataset,
)
from mrtask.likelihood.rows import label_rows


def build(homes, **overrides):
    return build_dataset(homes, **({"source": "made-up", "seed": 3, "code_version": "abc"} | overrides))


def test_written_dataset_reads_the_same(made_up_dataset, tmp_path):
    write_dataset(made_up_dataset, tmp_path / "rows")
    again = read_dataset(tmp_path / "rows")
    pd.testing.assert_frame_equal(again.rows, made_up_dataset.rows)
    assert again.manifest == made_up_dataset.manifest
    card = (tmp_path / "rows" / "README.md").read_text()
    assert made_up_dataset.manifest.content_hash in card and "| train | 120 | 600 | 3000 |" in card
    assert sorted(path.name for path in (tmp_path / "rows").iterdir()) == ["README.md", "manifest.json", "rows.parquet"]


def test_manifest_says_what_is_in_it(made_up_homes, made_up_dataset):
    manifest = made_up_dataset.manifest
    for split, homes in made_up_homes.items():
        positives = sum(len(container.objects) for home in homes for container in home.containers)
        expected = {"homes": len(homes), "containers": 5 * len(homes), "rows": 25 * len(homes), "positives": positives}
        assert manifest.counts[split] == pytest.approx(expected | {"positive_share": positives / (25 * len(homes))})
        assert set(manifest.split[split]) == {home.id for home in homes}
    assert manifest.vocabulary == ("Apple", "Book", "Bread", "Mug", "Pillow")


def test_vocabulary_is_that_of_the_training_homes(home_of):
    homes = {
        "train": [home_of(1, [("Bed", "Bedroom", ["Pillow"])])],
        "test": [home_of(2, [("Bed", "Bedroom", ["Sock"])])],
    }
    assert set(build(homes).rows["object"]) == {"Pillow"}


def test_order_of_homes_and_frames_made_elsewhere_change_nothing(made_up_homes):
    few = {split: homes[:6] for split, homes in made_up_homes.items()}
    plain = build(few)
    shuffled = build({split: homes[::-1] for split, homes in reversed(few.items())})
    every = [home for homes in few.values() for home in homes]
    frames = build(few, frames=[label_rows(home, plain.manifest.vocabulary) for home in reversed(every)])
    assert plain.manifest == shuffled.manifest == frames.manifest


def test_a_home_twice_in_one_split_counts_once(made_up_homes):
    few = made_up_homes["train"][:3]
    assert build({"train": [*few, few[0]]}).manifest == build({"train": few}).manifest


def test_home_on_two_sides_is_refused(made_up_homes):
    home = made_up_homes["train"][0]
    with pytest.raises(DatasetError, match=f"home {home.id} is in train and in test: give each home to one split"):
        build({"train": [home], "test": [home]})


@pytest.mark.parametrize(
    ("homes", "message"),
    [
        ({"train": []}, "no training homes"),
        ({"train": [[("Bed", "Bedroom", [])]]}, "hold no objects"),
        (
            {"train": [[("Bed", "Bedroom", ["Pillow"])]], "dev": []},
            "unknown split dev; allowed: train, validation, test",
        ),
    ],
)
def test_homes_that_teach_nothing_are_refused(home_of, homes, message):
    with pytest.raises(DatasetError, match=message):
        build({split: [home_of(1, contents) for contents in group] for split, group in homes.items()})


@pytest.mark.parametrize(
    ("column", "value"), [("label", 2), ("object", ""), ("split", "dev"), ("container_id", "Bed|2")]
)
def test_rows_that_break_the_schema_are_not_written(made_up_dataset, tmp_path, column, value):
    rows = made_up_dataset.rows.copy()
    rows[column] = np.int8(value) if column == "label" else pd.array([value] * len(rows), dtype="str")
    with pytest.raises(DatasetError, match="schema"):
        write_dataset(Dataset(rows, made_up_dataset.manifest), tmp_path / "rows")
    assert not (tmp_path / "rows" / "manifest.json").exists()


def test_changed_rows_are_refused(made_up_dataset, tmp_path):
    write_dataset(made_up_dataset, tmp_path)
    rows = made_up_dataset.rows.copy()
    rows.loc[7, "label"] = 1 - rows.loc[7, "label"]
    rows.to_parquet(tmp_path / "rows.parquet", index=False)
    with pytest.raises(DatasetError, match=r"rows.parquet is not what manifest.json says; delete the folder"):
        read_dataset(tmp_path)


def test_truncated_rows_and_manifest_are_refused(made_up_dataset, tmp_path):
    write_dataset(made_up_dataset, tmp_path)
    whole = (tmp_path / "rows.parquet").read_bytes()
    (tmp_path / "rows.parquet").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DatasetError, match="cannot be read"):
        read_dataset(tmp_path)
    manifest = (tmp_path / "manifest.json").read_text()
    (tmp_path / "manifest.json").write_text(manifest[:100])
    with pytest.raises(DatasetError, match="is not a dataset manifest"):
        read_manifest(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps(json.loads(manifest) | {"format_version": 99}))
    with pytest.raises(DatasetError, match="format version 99, this code reads 1: rebuild it"):
        read_manifest(tmp_path)
    with pytest.raises(DatasetError, match=r"no dataset in .*: run mrtask dataset"):
        read_dataset(tmp_path / "elsewhere")


def test_current_only_for_the_same_homes_in_the_same_split(made_up_dataset, tmp_path):
    split = made_up_dataset.manifest.split
    assert not is_current(tmp_path, split)
    write_dataset(made_up_dataset, tmp_path)
    assert is_current(tmp_path, {name: list(reversed(ids)) for name, ids in split.items()})
    assert not is_current(tmp_path, {**split, "test": split["test"][1:]})
    assert not is_current(tmp_path, {**split, "test": split["validation"], "validation": split["test"]})
    assert inputs_hash(split) == made_up_dataset.manifest.inputs_hash
    (tmp_path / "rows.parquet").unlink()
    assert not is_current(tmp_path, split)


def test_unknown_split_of_triples(made_up_dataset):
    with pytest.raises(ValueError, match="unknown split 'dev'; allowed: train, validation, test"):
        made_up_dataset.triples("dev")
