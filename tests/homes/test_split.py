import pytest

from mrtask.homes.split import split_homes

IDS = [f"{n:016x}" for n in range(100)]


def test_parts_are_disjoint_and_independent_of_order_and_duplicates():
    split = split_homes(IDS, 50, 20)
    again = split_homes([*reversed(IDS), *IDS[:30]], 50, 20)
    assert split == again
    assert [len(split.train), len(split.validation), len(split.test)] == [50, 20, 30]
    assert sorted([*split.train, *split.validation, *split.test]) == IDS
    assert len(split_homes(IDS, 50, 20, 5).test) == 5


def test_another_salt_divides_otherwise():
    assert split_homes(IDS, 50, 20).train != split_homes(IDS, 50, 20, salt="2").train


def test_a_home_keeps_its_part_when_the_last_ranks_leave():
    split = split_homes(IDS, 50, 20)
    assert split_homes([*split.train, *split.validation], 50, 20).train == split.train


def test_too_few_homes():
    with pytest.raises(ValueError, match=r"70 homes are requested \(train=50, validation=20, test=the rest\)"):
        split_homes([*IDS[:60], *IDS[:40]], 50, 20)
    with pytest.raises(ValueError, match="cannot be negative"):
        split_homes(IDS, -1, 20)
