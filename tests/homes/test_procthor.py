import gzip
import json

import pytest

from mrtask.homes.catalogue import CONTAINER_TYPES
from mrtask.homes.procthor import HouseError, load_asset_types, parse_house, read_houses


def read(house, assets):
    return parse_house(house, assets, "file.jsonl.gz", 7)


def test_containers_hold_the_distinct_types_of_all_their_descendants(two_room_home):
    held = {container.type: container.objects for container in two_room_home.containers}
    assert held == {"Fridge": ("Egg",), "DiningTable": (), "Bed": ("Book", "Pillow")}
    assert [obstacle.type for obstacle in two_room_home.obstacles] == ["FloorLamp"]
    assert two_room_home.container_kinds() == [("Fridge", "Kitchen"), ("DiningTable", "Kitchen"), ("Bed", "Bedroom")]


def test_a_door_is_measured_along_its_wall_polygon_not_its_id(two_room_home):
    (door,) = two_room_home.doors
    assert door.rooms == ("room|2", "room|3")
    assert (door.start, door.end) == ((4.0, 3.5), (4.0, 2.5))


def test_a_door_whose_wall_is_not_listed_is_measured_along_its_id(two_room_house, two_room_assets):
    two_room_house["walls"] = []
    (door,) = read(two_room_house, two_room_assets).doors
    assert (door.start, door.end) == ((4.0, 0.5), (4.0, 1.5))


def test_footprints_turn_clockwise_with_the_rotation(two_room_house, two_room_assets):
    by_type = {c.type: c for c in read(two_room_house, two_room_assets).containers}
    xs, ys = zip(*by_type["Bed"].footprint, strict=True)
    assert (min(xs), max(xs), min(ys), max(ys)) == pytest.approx((6.0, 8.0, 0.4, 2.0))
    two_room_house["objects"][1]["rotation"]["y"] = 30
    table = {c.type: c for c in read(two_room_house, two_room_assets).containers}["DiningTable"]
    # The right front corner (0.5, 0.3) of the table at (2, 3), turned clockwise by 30 degrees.
    assert table.footprint[2] == pytest.approx((2 + 0.5 * 0.866025 + 0.3 * 0.5, 3 - 0.5 * 0.5 + 0.3 * 0.866025))


def test_empty_walls_are_openings(two_room_house, two_room_assets):
    two_room_house["doors"] = []
    for wall in two_room_house["walls"]:
        wall["empty"] = True
    (opening,) = read(two_room_house, two_room_assets).doors
    assert set(opening.rooms) == {"room|2", "room|3"}
    assert {opening.start, opening.end} == {(4.0, 0.0), (4.0, 4.0)}


def test_types_come_from_ids_and_sizes_from_the_catalogue_without_an_asset_database(two_room_house, two_room_assets):
    for thing in two_room_house["objects"]:
        kind = two_room_assets[thing["assetId"]].type
        thing["id"] = f"{kind}|{thing['id']}"
        thing["assetId"] = "somebody's own"
        for number, child in enumerate(thing["children"]):
            child.update(id=f"Mug|surface|2|{number}", assetId="unknown", children=[])
    home = parse_house(two_room_house, None, "file", 0)
    assert [c.type for c in home.containers] == ["Fridge", "DiningTable", "Bed"]
    assert home.containers[0].objects == ("Mug",)
    assert [c.room_id for c in home.containers] == ["room|2", "room|2", "room|3"]


def test_ids_of_asset_groups_name_the_type_without_their_number(two_room_house, two_room_assets):
    child = {"id": "Mug_3|2|0|1", "assetId": "Mug_Made_Up_3"}
    two_room_house["objects"][0]["children"] = [two_room_house["objects"][0]["children"][0] | child | {"children": []}]
    assert parse_house(two_room_house, two_room_assets, "file", 0).containers[0].objects == ("Mug",)


def test_identity_is_content_not_source(two_room_house, two_room_assets):
    first = parse_house(two_room_house, two_room_assets, "a", 0)
    assert first.id == parse_house(two_room_house, two_room_assets, "b", 5).id
    two_room_house["objects"][0]["children"] = []
    assert first.id != parse_house(two_room_house, two_room_assets, "a", 0).id


def _set(path, value):
    def change(house):
        target = house
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = value

    return change


def _drop(path):
    def change(house):
        target = house
        for key in path[:-1]:
            target = target[key]
        del target[path[-1]]

    return change


TURN = {"rotation": {"y": 0}}
BAD_HOUSES = [
    (_drop(["rooms"]), "rooms: field required"),
    (_set(["rooms"], []), "rooms: list should have at least 1 item"),
    (_set(["rooms", 1, "id"], "room|2"), r"rooms\[1\]\.id: 'room\|2' is used twice"),
    (_set(["rooms", 0, "floorPolygon", 2, "x"], float("nan")), r"rooms\[0\]\.floorPolygon\[2\]\.x: input should be"),
    (
        _set(["rooms", 0, "floorPolygon", 2, "x"], "4"),
        r"rooms\[0\]\.floorPolygon\[2\]\.x: should be a number, not the text '4'",
    ),
    (_set(["rooms", 0, "floorPolygon", 2, "x"], 1e12), r"rooms\[0\]\.floorPolygon\[2\]\.x: input should be less than"),
    (_set(["rooms", 0, "floorPolygon", 2], {"x": 4, "z": -4}), r"rooms\[0\]\.floorPolygon: the polygon intersects"),
    (_set(["rooms", 0, "floorPolygon", 2], {"x": 0, "z": 1}), r"rooms\[0\]\.floorPolygon: the polygon"),
    (_set(["rooms", 0, "floorPolygon", 3, "x"], 6), r"rooms: 'room\|2' and 'room\|3' overlap"),
    (_set(["rooms", 1, "floorPolygon", 2, "x"], 300), "rooms: the home is 300 m wide, more than the 100 m allowed"),
    (_set(["rooms", 0, "roomType"], ""), r"rooms\[0\]\.roomType"),
    (_set(["doors", 0, "room1"], "room|9"), r"doors\[0\]\.room1: no room 'room\|9'; the rooms are room\|2, room\|3"),
    (
        _set(["doors", 0, "wall0"], "wall|2|0|0|0|4"),
        r"doors\[0\]\.wall0: the opening is not on the outline of 'room\|3'",
    ),
    (_set(["objects", 2, "position", "x"], 500.0), r"objects\[2\]\.position: the Bed '3\|0' stands in no room"),
    (_set(["doors", 0, "wall0"], "nonsense"), r"doors\[0\]\.wall0: no wall 'nonsense'"),
    (_set(["doors", 0, "holePolygon"], []), r"doors\[0\]\.holePolygon: list should have at least 2"),
    (
        _set(["doors", 0, "holePolygon", 1, "x"], 9.0),
        r"doors\[0\]\.holePolygon: the opening from 0.50 to 9.00 m is not on its",
    ),
    (_set(["objects"], []), "objects: no container among them"),
    (_set(["objects", 1, "id"], "2|0"), r"objects\[1\]\.id: '2\|0' is used twice"),
    (_set(["objects", 0, "position", "z"], float("inf")), r"objects\[0\]\.position\.z"),
    (_set(["objects", 0, "rotation"], None), r"objects\[0\]\.rotation"),
    (
        _set(["objects", 0, "assetId"], "Fridge_99"),
        r"objects\[0\]: '2\|0' names no type and its assetId 'Fridge_99' is not in",
    ),
    (_set(["objects", 0, "children", 1, "assetId"], "?"), r"objects\[0\]\.children\[1\]: 'small\|2\|1' names no type"),
    (_set(["objects", 0, "children"], {"a": 1}), r"objects\[0\]\.children: input should be a valid list"),
    (_set(["rooms", 1], 3), r"rooms\[1\]: should hold keys and values$"),
    (_set(["objects", 1, "rotation"], 90), r"objects\[1\]\.rotation: should hold keys and values$"),
    (
        _set(["objects", 0], {"id": "sofa-0 (living room)", "assetId": "0a3d", "position": {"x": 1, "z": 1}} | TURN),
        r"objects\[0\]: 'sofa-0 \(living room\)' is no id of ProcTHOR's houses .* such as Holodeck's, cannot be read",
    ),
    (
        _set(["objects", 0, "children"], [{"id": 'A "cup"|2|1'}]),
        r"objects\[0\]\.children\[0\]\.id: the name 'A \"cup\"' holds '\"'",
    ),
    (_set(["objects", 0, "id"], "9|0"), None),
]


@pytest.mark.parametrize(("change", "message"), BAD_HOUSES)
def test_bad_houses_are_refused_with_file_number_and_field(two_room_house, two_room_assets, change, message):
    change(two_room_house)
    if message is None:  # an unknown room in an id is no fault while the object stands in a room
        assert read(two_room_house, two_room_assets).containers[0].room_id == "room|2"
        return
    with pytest.raises(HouseError, match=r"^file\.jsonl\.gz, line 8: " + message):
        read(two_room_house, two_room_assets)


@pytest.mark.parametrize("value", [None, 3, "house", [], {}, {"rooms": 5}, {"rooms": [None]}])
def test_json_that_is_no_house(value):
    with pytest.raises(HouseError, match="line 8"):
        read(value, None)


def test_ids_without_type_need_the_asset_database(two_room_house):
    with pytest.raises(HouseError, match="give the asset database that has its assetId 'Lamp_77'"):
        two_room_house["objects"][0]["assetId"] = "Lamp_77"
        read(two_room_house, None)


def test_files(tmp_path, two_room_house, two_room_assets):
    database = {"Fridge": [{"assetId": "Fridge_1", "boundingBox": {"x": 0.8, "y": 1.8, "z": 0.6}}]}
    for name, asset in two_room_assets.items():
        if name != "Fridge_1":
            size = asset.size_m._asdict()
            database.setdefault(asset.type, []).append({"assetId": name, "boundingBox": size})
    assets = tmp_path / "assets.json"
    assets.write_text(json.dumps(database))
    assert load_asset_types(assets) == two_room_assets
    line = json.dumps(two_room_house)
    plain, packed, single = tmp_path / "a.jsonl", tmp_path / "b.jsonl.gz", tmp_path / "c.json"
    plain.write_text(f"{line}\n\n{line}\n")
    packed.write_bytes(gzip.compress(f"{line}\n".encode()))
    single.write_text(json.dumps(two_room_house, indent=1))
    homes = list(read_houses([plain, packed, single], assets))
    assert [home.source for home in homes] == ["a.jsonl", "a.jsonl", "b.jsonl.gz", "c.json"]
    assert len({home.id for home in homes}) == 1


def test_damaged_files(tmp_path, two_room_house):
    line = json.dumps(two_room_house) + "\n"
    cut = tmp_path / "cut.jsonl.gz"
    cut.write_bytes(gzip.compress("".join(line.replace("Fridge", f"Fridge{n}") for n in range(200)).encode())[:-50])
    skipped = []
    with pytest.raises(
        HouseError, match=r"cut\.jsonl\.gz, line \d+: the file is damaged or cut off after \d+ whole home"
    ):
        list(read_houses([cut], None, skipped.append))
    for name, content, problem in [
        ("not.jsonl", "{'a': 1}\n", "not.jsonl, line 1: is not JSON"),
        ("empty.jsonl", "\n", "the file holds no house"),
        ("binary.jsonl", b"\xff\xfe\x00", "damaged"),
        ("plain.jsonl.gz", line, "damaged"),
    ]:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(HouseError, match=problem):
            list(read_houses([path]))
    with pytest.raises(HouseError, match="no such file"):
        list(read_houses([tmp_path / "missing.jsonl"]))


def test_faulty_homes_can_be_skipped_and_counted(tmp_path, two_room_house, two_room_assets):
    database = tmp_path / "assets.json"
    by_type = {}
    for name, asset in two_room_assets.items():
        by_type.setdefault(asset.type, []).append({"assetId": name, "boundingBox": asset.size_m._asdict()})
    database.write_text(json.dumps(by_type))
    path = tmp_path / "homes.jsonl"
    path.write_text("\n".join([json.dumps(two_room_house), '{"rooms": []}', "nonsense", json.dumps(two_room_house)]))
    skipped = []
    assert len(list(read_houses([path], database, skipped.append))) == 2
    assert [error.number for error in skipped] == [1, 2]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", "an asset database is an object"),
        ('{"Bed": 3}', "Bed: should be a list"),
        ('{"Bed": [{"assetId": "b", "boundingBox": {"x": 1, "y": 1, "z": -1}}]}', r"Bed\[0\]\.boundingBox\.z"),
        ("{", "is not JSON"),
    ],
)
def test_bad_asset_databases(tmp_path, content, message):
    path = tmp_path / "assets.json"
    path.write_text(content)
    with pytest.raises(HouseError, match=message):
        load_asset_types(path)


def test_real_homes(shared_homes):
    files = [shared_homes / "procthor-2to3room.jsonl.gz", shared_homes / "procthor-4to10room.jsonl.gz"]
    homes = list(read_houses(files, shared_homes / "asset-database.json"))
    assert len(homes) == 1075
    classes = [[home.size_class for home in homes[:1000]].count(kind) for kind in ("small", "medium", "large")]
    assert classes == [544, 405, 51]
    kinds = {container.type for home in homes for container in home.containers}
    assert kinds <= CONTAINER_TYPES
    assert not kinds & {"FloorLamp", "HousePlant", "Box", "Painting", "BasketBall"}
    assert 10.5 < sum(len(home.containers) for home in homes[:1000]) / 1000 < 11.5
