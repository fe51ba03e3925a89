"""A formula as a person types it: in the shell, inside make's ARGS, in a file; and a task in words."""

import subprocess
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from mrtask.homes.home import Home
from mrtask.tasks.words import WordsError
from pipeline.app.main import CONF_DIR, _for_hydra
from pipeline.base.config import Config, UserError, load
from pipeline.episodes.plan import check, task_of

ROOT = Path(__file__).resolve().parents[3]
FORMULA = "F Mug & (!Laptop U Book)"


@pytest.fixture(autouse=True)
def _resolvers() -> None:
    for name in ("default_cache_dir", "stage_name", "stage_help"):
        OmegaConf.register_new_resolver(name, lambda: "/none", replace=True)
    OmegaConf.register_new_resolver("sweep_dir", lambda output_dir: output_dir, replace=True)


def make(*arguments: str) -> Config:
    with initialize_config_dir(str(CONF_DIR), version_base="1.3"):
        return load(compose("config", [_for_hydra(argument) for argument in arguments]))


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
    assert make(*arguments).evaluation.formula == FORMULA


@pytest.mark.parametrize("given", [f"'{FORMULA}'", f'"{FORMULA}"', FORMULA, f"  {FORMULA} "])
def test_quotes_for_hydra_are_not_needed_and_do_no_harm(given: str) -> None:
    assert make(f"evaluation.formula={given}").evaluation.formula == FORMULA


def test_no_formula_and_other_keys_are_left_alone() -> None:
    assert make("evaluation.formula=null").evaluation.formula is None
    assert _for_hydra("evaluation.formula_file=a,b") == "evaluation.formula_file=a,b"
    assert _for_hydra("planner.pouct.samples=1,2") == "planner.pouct.samples=1,2"
    assert _for_hydra("evaluation.formula=F a & F b,F c") == "evaluation.formula='F a & F b','F c'"


def test_a_formula_comes_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "task.ltl"
    path.write_text(FORMULA.replace(" & ", " &\n  ") + "\n")
    assert make(f"evaluation.formula_file={path}").evaluation.formula == FORMULA
    with pytest.raises(UserError, match="not both"):
        make(f"evaluation.formula_file={path}", "evaluation.formula=F Mug")
    with pytest.raises(UserError, match=r"evaluation\.formula_file=.*nowhere: cannot be read"):
        make(f"evaluation.formula_file={tmp_path / 'nowhere'}")


@pytest.mark.parametrize("given", ["laptop or book, then remote", "'laptop or book, then remote'"])
def test_a_task_in_words_is_one_whatever_its_commas(given: str) -> None:
    assert make(f"evaluation.task={given}").evaluation.task == "laptop or book, then remote"
    with pytest.raises(UserError, match="not both"):
        make(f"evaluation.task={given}", "evaluation.formula=F Mug")


def test_words_name_the_objects_of_the_homes(two_room_home: Home) -> None:
    options = make("evaluation.task=the egg, then pillow").evaluation
    check(options)
    assert task_of(options, [two_room_home]) == ("(!Pillow U Egg) & F Pillow", ("Egg", "Pillow"))
    with pytest.raises(WordsError, match="'unicorn' is not an object here"):
        task_of(make("evaluation.task=unicorn").evaluation, [two_room_home])
    with pytest.raises(WordsError, match="could mean different things"):
        check(make("evaluation.task=egg and pillow or book").evaluation)
    assert task_of(make().evaluation, [two_room_home]) == (None, ())
    assert task_of(make("evaluation.formula=F Unicorn").evaluation, [two_room_home]) == ("F Unicorn", ("Unicorn",))
