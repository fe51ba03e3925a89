from mrtask.analysis.report.coordination import Coordination, coordination
from mrtask.execution.trace import Leg, Letter, Trace
from tests.analysis.synthetic import rows

PLACE = ((0.0, 0.0),)


def leg(kind: str, t0_s: float, t1_s: float, container: str) -> Leg:
    return Leg(kind, t0_s, t1_s, container, None, PLACE)


def team(first: list[Leg], second: list[Leg], *letters: Letter) -> str:
    return Trace((0.0, 0.0), (tuple(first), tuple(second)), letters).to_json()


FIRST = [leg("move", 0, 9, "bed"), leg("search", 9, 9, "bed")]
A, B = Letter(9, 0, "a", "bed"), Letter(9, 1, "b", "sink")
TO_SINK = [leg("move", 0, 4, "sink"), leg("search", 4, 4, "sink")]
WAITED = team(FIRST, [*TO_SINK, leg("wait", 4, 6, "sink"), leg("wait", 6, 9, "sink")], A, B)
IN_TIME = team(FIRST, [leg("move", 0, 9, "sink"), leg("search", 9, 9, "sink")], A, B)
WAITED_FOR_NOTHING = team([], [*TO_SINK, leg("wait", 4, 9, "sink")], B)
BACK = [leg("move", 9, 12, "sink")]
WENT_ON = team(
    FIRST, [*TO_SINK, leg("move", 4, 8, "sofa"), leg("search", 8, 8, "sofa"), *BACK], A, Letter(12, 1, "b", "sink")
)
LATER_TAKEN_BY_ANOTHER = team(
    [*FIRST, leg("move", 9, 12, "sink")],
    [*TO_SINK, leg("move", 4, 8, "sofa"), leg("search", 8, 8, "sofa")],
    A,
    Letter(12, 0, "b", "sink"),
)
SEARCHED_BEFORE = team(
    FIRST,
    [leg("move", 0, 2, "sofa"), leg("search", 2, 2, "sofa"), leg("move", 2, 4, "sink"), leg("search", 4, 4, "sink")],
    A,
    B,
)
STAYED_AWAY = team(FIRST, [*TO_SINK, leg("move", 4, 6, "sofa"), leg("move", 6, 9, "sink")], A, B)


def found(trace: str | None, formula: str = "(!b U a) & F b", robots: int = 2) -> tuple[int, int, int] | None:
    frame = rows("small", robots, {"pouct": [9.0]}).assign(trace=trace, formula=formula)
    one = coordination(frame, "pouct")
    return None if one is None else (one.episodes, len(one.waits), len(one.goes_on))


def test_by_hand():
    assert found(WAITED) == (1, 1, 0)
    assert found(IN_TIME) == (1, 0, 0), "who arrives at the same time did not wait"
    assert found(WAITED_FOR_NOTHING) == (1, 0, 0), "no teammate did anything"
    assert found(WENT_ON) == found(LATER_TAKEN_BY_ANOTHER) == (1, 0, 1)
    assert found(SEARCHED_BEFORE) == (1, 0, 0), "it had seen nothing that the task needs yet"
    assert found(STAYED_AWAY) == (1, 0, 0), "it searched nothing else"


def test_where_it_cannot_be_seen():
    assert found(WAITED, "F a & F b") is None and found(WAITED, robots=1) is None and found(None) is None
    frame = rows("small", 2, {"pouct": [9.0]})
    assert coordination(frame, "pouct") is None
    assert coordination(frame.assign(trace=WAITED, formula="!b U a"), "greedy") is None


def test_episodes_whose_traces_were_not_read_are_told_apart():
    frame = rows("small", 2, {"pouct": [9.0, 9.0, None]}).assign(trace=[WAITED, None, WAITED], formula="!b U a")
    assert coordination(frame, "pouct") == Coordination(1, 2, ("small-2-000",), ())
