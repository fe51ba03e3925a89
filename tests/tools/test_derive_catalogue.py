import gzip
import json

import pytest
from shapely.geometry import Polygon

from mrtask.homes.catalogue import CONTAINER_TYPES, load_catalogue
from mrtask.homes.home import SIZE_CLASSES
from mrtask.homes.procthor import load_asset_types
from tools.derive_catalogue import _cell_side_m, derive, divide, main


def shares_in(value):
    """All histograms in a part of the catalogue."""
    if isinstance(value, dict):
        for child in value.values():
            yield from shares_in(child)
    elif value and isinstance(value[0], list):
        yield from value


def test_facts_are_consistent():
    catalogue = load_catalogue()
    assert set(catalogue.types) >= CONTAINER_TYPES
    for kind, entry in catalogue.types.items():
        assert all(side > 0 for side in entry["size_m"])
        assert entry["assets"], kind
    for room, facts in catalogue.rooms.items():
        classes = len(facts["area_classes_m2"]) + 1
        assert facts["area_classes_m2"] == sorted(facts["area_classes_m2"])
        for part in ("furniture", "chairs_at"):
            assert set(facts[part]) <= set(catalogue.types)
            assert all(len(per_class) == classes for per_class in facts[part].values())
            assert all(sum(shares) == pytest.approx(1, abs=0.01) for shares in shares_in(facts[part])), room
        assert set(catalogue.objects[room]) <= CONTAINER_TYPES
    for size_class in catalogue.homes["size_classes"].values():
        assert sum(entry["share"] for entry in size_class.values()) == pytest.approx(1, abs=0.01)
    assert set(catalogue.homes["footprints"]) == set(SIZE_CLASSES)
    for facts in catalogue.homes["footprints"].values():
        assert all(quantiles == sorted(quantiles) for quantiles in facts.values())
        assert 0 < facts["fill"][0] <= facts["fill"][-1] == 1 <= facts["aspect"][0]
    for spec in catalogue.homes["specs"].values():
        assert sum(room["area_share"] for room in spec) == pytest.approx(1, abs=0.12)


@pytest.mark.parametrize("side_m", [1.6, 1.737, 1.95, 2.2])
def test_the_side_of_a_floor_plans_cells_is_found(side_m):
    # Rooms of 2 x 3 and 3 x 3 cells, the second an L.
    rooms = [[(0, 0), (0, 3), (2, 3), (2, 0)], [(2, 0), (2, 3), (5, 3), (5, 1), (4, 1), (4, 0)]]
    floors = [Polygon([(round(x * side_m, 3), round(y * side_m, 3)) for x, y in room]) for room in rooms]
    assert _cell_side_m(floors) == pytest.approx(side_m, abs=0.01)


def test_likelihoods_agree_with_the_numbers_of_objects():
    for containers in load_catalogue().objects.values():
        for facts in containers.values():
            mean = sum(count * share for count, share in enumerate(facts["distinct_objects"]))
            assert sum(facts["likelihoods"].values()) == pytest.approx(mean, rel=0.05, abs=0.05)


def test_the_catalogue_is_what_its_script_makes_of_the_real_homes(shared_homes):
    houses = []
    for name in ("procthor-2to3room.jsonl.gz", "procthor-4to10room.jsonl.gz"):
        with gzip.open(shared_homes / name, "rt") as lines:
            houses += [json.loads(line) for line in lines]
    facts = derive(houses, load_asset_types(shared_homes / "asset-database.json"))
    catalogue = load_catalogue()
    for section in ("homes", "doors", "rooms", "types", "objects"):
        assert json.loads(json.dumps(facts[section])) == json.loads(json.dumps(getattr(catalogue, section))), section


def test_a_share_of_the_homes_depends_on_their_content_alone():
    houses = [{"rooms": [number], "objects": []} for number in range(200)]
    inside, outside = divide(houses, 0.0, 0.5)
    assert 70 < len(inside) < 130 and not [house for house in inside if house in outside]
    backwards, _ = divide([{"objects": [], "rooms": house["rooms"]} for house in reversed(houses)], 0.0, 0.5)
    assert sorted(house["rooms"] for house in backwards) == sorted(house["rooms"] for house in inside)
    lower, upper = divide(houses, 0.0, 0.25)[0], divide(houses, 0.25, 0.5)[0]
    assert sorted(house["rooms"] for house in (*lower, *upper)) == sorted(house["rooms"] for house in inside)
    assert divide(houses, 0.0, 1.0) == (houses, [])


@pytest.mark.parametrize("share", [("0.5", "0.5"), ("0", "1.5"), ("0.999", "1")])
def test_a_share_without_homes_is_refused(share, tmp_path, capsys, monkeypatch):
    with gzip.open(tmp_path / "homes.jsonl.gz", "wt") as file:
        file.write(json.dumps({"rooms": []}) + "\n")
    (tmp_path / "assets.json").write_text("{}")
    files = [str(tmp_path / "homes.jsonl.gz"), "--assets", str(tmp_path / "assets.json")]
    monkeypatch.setattr(
        "sys.argv", ["derive_catalogue.py", *files, "--out", str(tmp_path / "out.yaml"), "--share", *share]
    )
    with pytest.raises(SystemExit):
        main()
    assert f"--share {float(share[0]):g} {float(share[1]):g}: " in capsys.readouterr().err
    assert not (tmp_path / "out.yaml").exists()
