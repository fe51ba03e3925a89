"""The command ``mrtask``, and what all commands have in common."""

import ast
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from mrtask import __version__, cli
from mrtask.errors import INTERRUPT_EXIT, USER_ERROR_EXIT

ROOT = Path(__file__).resolve().parents[1]


def mrtask(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mrtask.cli", *arguments]
    return subprocess.run(command, cwd=cwd, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120)


def test_every_stage_and_tool_is_a_command() -> None:
    known = cli.commands()
    modules = {path.stem for path in (ROOT / "pipeline").glob("*.py") if '__name__ == "__main__"' in path.read_text()}
    modules.add("live")
    assert {name for name, command in known.items() if command.module.startswith("pipeline.")} == modules
    for name, command in known.items():
        assert find_spec(command.module) is not None
        assert f"  mrtask {name:11} {command.text}" in cli.usage(known)


@pytest.mark.parametrize("name", ["scenario", "live"])
def test_tools_start_by_the_command(name: str, tmp_path: Path) -> None:
    helped = mrtask(name, "--help", cwd=tmp_path)
    assert helped.returncode == 0 and f"python -m pipeline.{name}" in helped.stdout
    wrong = mrtask(name, "nam=apartment1", "name=apartment1", cwd=tmp_path)
    assert wrong.returncode == USER_ERROR_EXIT and "nam: no such key; did you mean name?" in wrong.stderr


def test_a_command_that_is_none_is_refused_and_all_are_listed() -> None:
    done = mrtask("reproduced")
    assert (
        done.returncode == USER_ERROR_EXIT and "no command 'reproduced'" in done.stderr and "mrtask live" in done.stderr
    )


def test_the_version_is_that_of_the_library() -> None:
    done = mrtask("--version")
    assert done.returncode == 0 and done.stdout == f"mrtask {__version__}\n"
    assert "mrtask --version" in mrtask("--help").stdout


def test_exit_codes_are_written_in_one_place() -> None:
    written = {
        path.relative_to(ROOT).as_posix()
        for package in ("mrtask", "pipeline")
        for path in (ROOT / package).rglob("*.py")
        if _writes_an_exit_code(ast.parse(path.read_text()))
    }
    assert written == {"mrtask/errors.py"}


def _writes_an_exit_code(module: ast.Module) -> bool:
    """Whether an exit code for mistakes or interrupts is assigned, or given to an exit, as a number."""
    codes = {USER_ERROR_EXIT, INTERRUPT_EXIT}
    for node in ast.walk(module):
        named = isinstance(node, ast.Assign) and any("EXIT" in ast.unparse(target) for target in node.targets)
        called = isinstance(node, ast.Call) and ast.unparse(node.func) in ("sys.exit", "os._exit", "SystemExit")
        if (named or called) and any(isinstance(one, ast.Constant) and one.value in codes for one in ast.walk(node)):
            return True
    return False
