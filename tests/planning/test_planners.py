"""Planners by name and by class."""

import sys

import pytest

from mrtask.errors import InputError
from mrtask.planning.planner import PlanOnly
from mrtask.planning.planners import PLANNERS, as_planner, make_planner, planner_name
from mrtask.planning.problem import Plan


class Own:
    """A planner of a user's own, with nothing but `plan`."""

    def __init__(self, pace=1.0):
        self.pace = pace

    def plan(self, problem, seed):
        return Plan({})


def test_every_planner_of_ours_is_named_by_its_class_whatever_its_options():
    assert {name: planner_name(make_planner(name)) for name in PLANNERS} == {name: name for name in PLANNERS}
    assert planner_name(PLANNERS["pouct"].planner(samples=7)) == "pouct"
    assert planner_name(PLANNERS["known"].planner(samples=7)) == "known"


def test_a_planner_of_ones_own_has_the_name_by_which_it_can_be_made():
    name = planner_name(PlanOnly(Own().plan))
    assert name == f"{__name__}.Own"
    assert planner_name(make_planner(name, {"pace": 2.0})) == name == planner_name(Own())


def test_a_derived_planner_is_not_ours():
    class Hasty(PLANNERS["pouct"].planner):
        """Ours with another name."""

    assert planner_name(Hasty(samples=1)) == f"{__name__}.{Hasty.__qualname__}"


@pytest.mark.parametrize("name", [*PLANNERS, f"{__name__}.Own"])
def test_an_unknown_option_is_refused_with_all_that_the_planner_takes(name):
    takes = {
        "nonlearned_myopic": r"reassign: str = 'all', return_to_known: str = 'at_once'",
        "learned_myopic": r"reassign: str = 'all', return_to_known: str = 'at_once'",
        "greedy": r"later_weight: float = 0\.3, reassign: str = 'all'",
        "pouct_paper": r"samples: int = 100000, .*leaf: str = 'revealed', .*reassign: str = 'free'",
        "pouct": r"samples: int = 100000, .*later_weight: float = 0\.3, reassign: str = 'all'",
        "known": r"samples: int = 100000, .*later_weight: float = 0\.3, reassign: str = 'all'",
        f"{__name__}.Own": r"pace=1\.0",
    }[name]
    with pytest.raises(InputError, match=rf"planner '{name}' refuses its options: .*'smaples'; it takes \({takes}\)"):
        make_planner(name, {"smaples": 5})


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("def plan(:", r"cannot be imported: SyntaxError: .*\(wrong_planner.py, line 1\)"),
        ("x = 1\ny = z", r"cannot be imported: NameError: name 'z' is not defined \(wrong_planner.py, line 2\)"),
        ("import nothing_of_this_name", "cannot be imported: No module named 'nothing_of_this_name'"),
        ("class Other: pass", "cannot be imported: module 'wrong_planner' has no attribute 'Wrong'"),
        ("class Wrong: pass", r"has no method plan\(problem, seed\), which every planner needs"),
        ("Wrong = 3", "is no class or function, but 3"),
        ("class Wrong:\n def __init__(self): {}[4]", r"cannot be made: KeyError: 4 \(wrong_planner.py, line 2\)"),
        ("class Wrong:\n plan = 4", "has no method plan"),
    ],
)
def test_a_file_without_a_planner_is_refused_in_one_message(tmp_path, monkeypatch, code, message):
    (tmp_path / "wrong_planner.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "wrong_planner", raising=False)
    with pytest.raises(InputError, match=f"^planner 'wrong_planner.Wrong' {message}"):
        make_planner("wrong_planner.Wrong")


def test_whatever_is_no_planner_is_refused_with_what_a_planner_needs():
    with pytest.raises(InputError, match=r"^4 has no method plan\(problem, seed\)"):
        as_planner(4)
    with pytest.raises(InputError, match=r"Own'> is a class; call it to make a planner"):
        as_planner(Own)
    with pytest.raises(InputError, match=r"unknown planner '\.\.'"):
        as_planner("..")
