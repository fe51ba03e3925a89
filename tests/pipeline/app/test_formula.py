"""A formula as a person types it: in the shell, inside make's ARGS, in a file; and a task in words."""

import re
import subprocess
from pathlib import Path

import pytest

from mrtask.homes.home import Home
from mrtask.tasks.formula import FormulaError
from mrtask.tasks.words import WordsError
from pipeline.app.main import _for_hydra
from pipeline.base.config import UserError
from pipeline.episodes.plan import check, task_of
from tests.pipeline.configured import configured

ROOT = Path(__file__).resolve().parents[3]
FORMULA = "F Mug & (!Laptop U Book)"


def arguments_of(command: str, folder: Path) -> list[str]:
    """What ``python`` is called with in a shell, one argument a line."""
    python = folder / "bin" / "python"
    python.parent.mkdir()
    python.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    python.chmod(0o755)
    (folder / ".installed").touch()
    shell = ["bash", "-c", f'PATH="{python.parent}:$PATH"; {command} VENV="{folder}"']
    return subprocess.run(shell, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.parametrize(
    "command",
    [
        f"python -m pipeline.evaluate evaluation.formula='{FORMULA}'",
        f"""make reproduce ARGS='evaluation.formula="{FORMULA}"'""",
        f"""make reproduce ARGS="evaluation.formula='{FORMULA}' seed=3" """,
    ],
)
def test_the_shells_quotes_are_enough(command: str, tmp_path: Path) -> None:
    arguments = [one for one in arguments_of(command, tmp_path) if one.startswith(("evaluation", "seed"))]
    assert configured(*arguments).evaluation.formula == FORMULA


@pytest.mark.parametrize("given", [f"'{FORMULA}'", f'"{FORMULA}"', FORMULA, f"  {FORMULA} "])
def test_quotes_for_hydra_are_not_needed_and_do_no_harm(given: str) -> None:
    assert configured(f"evaluation.formula={given}").evaluation.formula == FORMULA


OWN_MAP = ("homes=ros_map", "homes.map=lab.yaml", "homes.containers=containers.yaml")
"""Only in a user's own homes can objects have such names."""


@pytest.mark.parametrize(
    "formula", ['F "c-clamp" & F Mug', '"c-clamp" U "b-c"', """F "child's cup" & F "a, b\"""", 'X "c-clamp"']
)
def test_names_in_quotes_pass_through_hydra(formula: str) -> None:
    assert configured(*OWN_MAP, f"evaluation.formula={formula}").evaluation.formula == formula
    assert configured(*OWN_MAP, f"evaluation.task={formula}").evaluation.task == formula
    assert _for_hydra('evaluation.formula=F "a,b",F c') == """evaluation.formula='F "a,b"','F c'"""
    assert _for_hydra('evaluation.formula="F a","F b"') == 'evaluation.formula="F a","F b"'


def test_no_formula_and_other_keys_are_left_alone() -> None:
    assert configured("evaluation.formula=null").evaluation.formula is None
    assert _for_hydra("evaluation.formula_file=a,b") == "evaluation.formula_file=a,b"
    assert _for_hydra("planner.pouct.samples=1,2") == "planner.pouct.samples=1,2"
    assert _for_hydra("evaluation.formula=F a & F b,F c") == "evaluation.formula='F a & F b','F c'"


def test_a_formula_comes_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "task.ltl"
    path.write_text(FORMULA.replace(" & ", " &\n  ") + "\n")
    assert configured(f"evaluation.formula_file={path}").evaluation.formula == FORMULA
    with pytest.raises(UserError, match="not both"):
        configured(f"evaluation.formula_file={path}", "evaluation.formula=F Mug")
    with pytest.raises(UserError, match=r"evaluation\.formula_file=.*nowhere: cannot be read"):
        configured(f"evaluation.formula_file={tmp_path / 'nowhere'}")


@pytest.mark.parametrize("given", ["laptop or book, then remote", "'laptop or book, then remote'"])
def test_a_task_in_words_is_one_whatever_its_commas(given: str) -> None:
    assert configured(f"evaluation.task={given}").evaluation.task == "laptop or book, then remote"
    with pytest.raises(UserError, match="not both"):
        configured(f"evaluation.task={given}", "evaluation.formula=F Mug")


def test_words_name_the_objects_of_the_homes(two_room_home: Home) -> None:
    options = configured("evaluation.task=the egg, then pillow").evaluation
    check(options)
    assert task_of(options, [two_room_home]) == ("(!Pillow U Egg) & F Pillow", ("Egg", "Pillow"))
    with pytest.raises(WordsError, match="'unicorn' is not an object here"):
        task_of(configured("evaluation.task=unicorn").evaluation, [two_room_home])
    with pytest.raises(WordsError, match="could mean different things"):
        check(configured("evaluation.task=egg and pillow or book").evaluation)
    assert task_of(configured().evaluation, [two_room_home]) == (None, ())
    assert task_of(configured("evaluation.formula=F Pillow").evaluation, [two_room_home]) == ("F Pillow", ("Pillow",))
    with pytest.raises(FormulaError, match="unknown object 'Laptop'; allowed: Book, Egg, Pillow"):
        task_of(configured("evaluation.formula=F Laptop").evaluation, [two_room_home])


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("F Mugg", "unknown object 'Mugg', did you mean 'Mug'"),
        ("F mug", "unknown object 'mug', did you mean 'Mug'"),
        ("F Fridge", "unknown object 'Fridge'"),
        ("FLaptop", "unknown object 'FLaptop', did you mean 'F Laptop'"),
        ("F (Mug & !Mug)", "no order of interactions does this task"),
        ("(!Mug U Laptop) & (!Laptop U Mug)", "no order of interactions does this task"),
        ("true", "done before anything is done"),
        ("Mug | !Mug", "done before anything is done"),
    ],
)
def test_a_formula_that_is_no_task_is_refused_with_the_configuration(formula: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "task.ltl").write_text(formula)
    for given in (f"evaluation.formula={formula}", f"evaluation.formula_file={tmp_path / 'task.ltl'}"):
        with pytest.raises(FormulaError, match=re.escape(said)):
            configured(given)


def test_names_of_homes_that_are_only_read_later_are_checked_then() -> None:
    formula = "F Unicorn"
    assert configured(f"evaluation.formula={formula}", "evaluation.homes.files=[a.jsonl]").evaluation.formula == formula
    assert configured(f"evaluation.formula={formula}", "homes=procthor", "homes.files=[a.jsonl]").evaluation.formula
