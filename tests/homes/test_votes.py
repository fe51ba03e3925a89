"""Votes are read without running what a pickle asks for, and bad data are refused in a sentence."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from mrtask.homes.download import HOUSEKEEP, VOTES_FILE
from mrtask.homes.votes import (
    SPLITS_SHA256,
    VotesError,
    object_type,
    read_splits,
    read_votes,
    split_objects,
    splits_hash,
)
from tests.homes.made_up_votes import Evil, content, write, write_splits

HUMAN = Path(__file__).parents[2].parent / "shared" / "human"


@pytest.mark.parametrize("numpy_1", [True, False])
def test_votes_are_read_whichever_numpy_wrote_them(numpy_1, tmp_path):
    votes = read_votes(write(tmp_path / "votes.npy", numpy_1=numpy_1))
    assert b"numpy.core" in (tmp_path / "votes.npy").read_bytes() or not numpy_1
    assert votes.objects == ("Mug", "RemoteControl", "Pillow", "ToothBrush", "CatToy", "SpareKey")
    assert votes.placements[:2] == (("bedroom", "bed"), ("bedroom", "chest"))
    np.testing.assert_array_equal(votes.ranks, content()["ranks"])
    for place, right, misplaced in zip(content()["ranks"], votes.share_right, votes.share_misplaced, strict=True):
        assert right.tolist() == [sum(rank > 0 for rank in ranks) / 4 for ranks in place]
        assert misplaced.tolist() == [sum(rank < 0 for rank in ranks) / 4 for ranks in place]


def test_the_checksum_is_checked_where_one_is_given(tmp_path):
    path = write(tmp_path / "votes.npy")
    assert read_votes(path, hashlib.sha256(path.read_bytes()).hexdigest()).objects
    with pytest.raises(
        VotesError, match=rf"has the sha256 .*, expected {'0' * 64}: it is damaged, or data of your own"
    ):
        read_votes(path, "0" * 64)


def test_no_class_but_numpys_arrays_is_unpickled(tmp_path):
    path = write(tmp_path / "votes.npy", content() | {"more": Evil(tmp_path / "ran")})
    with pytest.raises(
        VotesError, match=r"votes.npy is not read: its pickle asks for posix.mkdir; only numpy's arrays"
    ):
        read_votes(path)
    assert not (tmp_path / "ran").exists()
    np.load(path, allow_pickle=True)  # what the reader is for
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"objects": ["mug"]}, r"of 17 places and 6 objects, but 17 places and 1 objects are named"),
        ({"ranks": np.zeros((17, 6))}, r"ranks must be whole numbers of three dimensions"),
        ({"ranks": np.zeros((17, 6, 0), dtype=int)}, r"ranks must be .* none empty"),
        ({"room_receptacles": ["kitchen"] * 17}, r"must be named room\|receptacle, got 'kitchen'"),
        ({"objects": ["mug", " ", "pillow", "brush", "toy", "key"]}, r"' ' is not an object name; letters"),
        ({"objects": ["mug", "Mug", "pillow", "brush", "toy", "key"]}, r"two objects are called 'mug'"),
        ({"objects": [], "ranks": np.zeros((17, 0, 4), dtype=int)}, r"ranks must be .* none empty"),
    ],
)  # fmt: skip
def test_data_that_do_not_fit_together_are_refused(changed, message, tmp_path):
    with pytest.raises(VotesError, match=message):
        read_votes(write(tmp_path / "votes.npy", content() | changed))


def test_an_object_without_a_right_place_is_refused(tmp_path):
    ranks = content()["ranks"]
    ranks[:, 2] = np.minimum(ranks[:, 2], 0)
    with pytest.raises(VotesError, match=r"nobody knows a right place for the object 'pillow'; leave it out"):
        read_votes(write(tmp_path / "votes.npy", content() | {"ranks": ranks}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "no such file of votes"),
        (lambda path: path.write_bytes(path.read_bytes()[:1000]), "is not read: pickle data was truncated"),
        (lambda path: path.write_text("room,receptacle"), "is damaged or not a file of votes"),
        (lambda path: np.save(path, np.zeros(3)), "an array of float64 instead of one pickled dict"),
        (lambda path: write(path, ["mug"]), "expected a dict with ranks, .*, found <class 'list'"),
        (lambda path: write(path, {"ranks": 1}), "has no 'objects'; it must hold"),
    ],
)  # fmt: skip
def test_a_file_that_holds_no_votes_is_refused(damage, message, tmp_path):
    path = write(tmp_path / "votes.npy")
    damage(path)
    with pytest.raises(VotesError, match=message):
        read_votes(path)


def test_splits(tmp_path):
    path = write_splits(tmp_path / "splits.yaml")
    splits = read_splits(path)
    assert split_objects(splits, "test") == ("CatToy", "SpareKey")
    with pytest.raises(VotesError, match="unknown split 'validation' of the objects; allowed: train, val, test"):
        split_objects(splits, "validation")
    with pytest.raises(VotesError, match="the split 'val' has no objects; give other splits"):
        split_objects({"train": ("Mug",), "val": (), "test": ("Pen",)}, "val")
    assert read_splits(path, splits_hash(splits)) == splits
    with pytest.raises(VotesError, match=r"its names have the sha256 .*: these are other splits"):
        read_splits(path, "0" * 64)
    votes = read_votes(write(tmp_path / "votes.npy")).of(splits["test"])
    assert votes.objects == splits["test"]
    np.testing.assert_array_equal(votes.ranks, content()["ranks"][:, 4:])
    with pytest.raises(VotesError, match="no object 'Unicorn'; are votes and splits of the same data"):
        votes.of(["Unicorn"])


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"train": ["mug"], "val": []}, r"is not a file of splits \('test'\)"),
        ({"train": ["mug"], "val": ["Mug"], "test": []}, "the object 'Mug' is listed twice"),
    ],
)
def test_bad_splits_are_refused(splits, message, tmp_path):
    with pytest.raises(VotesError, match=message):
        read_splits(write_splits(tmp_path / "splits.yaml", splits))
    with pytest.raises(VotesError, match="no such file of splits"):
        read_splits(tmp_path / "gone.yaml")


def test_names_become_object_types():
    assert [object_type(name) for name in ("mug", "remote_control", "set-top_box", " usb drive ")] == [
        "Mug", "RemoteControl", "SetTopBox", "UsbDrive",
    ]  # fmt: skip


@pytest.mark.skipif(not HUMAN.is_dir(), reason="the real votes are not here")
def test_the_real_votes():
    votes = read_votes(HUMAN / "housekeep-data.npy", HOUSEKEEP[VOTES_FILE].sha256)
    assert votes.ranks.shape == (128, 269, 10)
    assert int((votes.ranks != 0).sum()) == 221212
    splits = read_splits(HUMAN / "housekeep-splits.json", SPLITS_SHA256)
    assert [len(splits[name]) for name in ("train", "val", "test")] == [110, 27, 132]
    assert sorted(votes.objects) == sorted(name for split in splits.values() for name in split)
