"""Labelled rows against hand-made homes and a naive count."""

from collections import Counter

import pandas as pd

from mrtask.likelihood.rows import TRIPLE, count_triples, distinct_triples, label_rows, vocabulary


def test_one_row_per_container_and_object_in_their_order(home_of):
    home = home_of(1, [("Bed", "Bedroom", ["Pillow"]), ("Fridge", "Kitchen", []), ("Bed", "Bedroom", ["Book", "Cup"])])
    rows = label_rows(home, ["Book", "Pillow"])
    assert rows.to_dict("list") == {
        "object": ["Book", "Pillow"] * 3,
        "container": ["Bed"] * 2 + ["Fridge"] * 2 + ["Bed"] * 2,
        "room": ["Bedroom"] * 2 + ["Kitchen"] * 2 + ["Bedroom"] * 2,
        "home_id": [home.id] * 6,
        "container_id": ["Bed|0"] * 2 + ["Fridge|1"] * 2 + ["Bed|2"] * 2,
        "label": [0, 1, 0, 0, 1, 0],
    }


def test_home_without_containers_has_no_rows(home_of):
    rows = label_rows(home_of(1, []), ["Book"])
    assert len(rows) == 0 and rows.columns[0] == "object"


def test_vocabulary_is_what_lies_in_containers(home_of):
    homes = [home_of(1, [("Bed", "Bedroom", ["Pillow"])]), home_of(2, [("Desk", "Bedroom", ["Book", "Pillow"])])]
    assert vocabulary(homes) == ("Book", "Pillow")
    assert vocabulary([]) == ()


def test_distinct_triples_equal_a_naive_count(made_up_homes):
    rows = pd.concat([label_rows(home, ["Apple", "Book", "Mug"]) for home in made_up_homes["train"][:20]])
    count, positives = Counter(), Counter()
    for row in rows.itertuples():
        key = (row.object, row.container, row.room)
        count[key] += 1
        positives[key] += row.label
    triples = distinct_triples(rows)
    found = {tuple(row[:3]): tuple(row[3:]) for row in triples.to_numpy().tolist()}
    assert found == {key: (positives[key], count[key]) for key in count}


def test_counts_of_homes_are_those_of_their_rows(made_up_homes):
    homes = made_up_homes["train"][:20]
    objects = vocabulary(homes)
    rows = pd.concat([label_rows(home, objects) for home in homes])
    pd.testing.assert_frame_equal(
        count_triples(homes).sort_values(TRIPLE, ignore_index=True), distinct_triples(rows), check_like=True
    )
    some = count_triples(homes, ["Mug", "Apple"])
    assert set(some["object"]) == {"Mug", "Apple"}
    assert some["positives"].sum() == rows[rows["object"].isin(["Mug", "Apple"])]["label"].sum()
