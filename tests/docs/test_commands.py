"""Every command and program that README and the documentation (guides included) print can be run unchanged.

Python blocks are executed. A shell parses the commands; the programs that they call exist, and every line of Hydra
overrides is composed and checked by the schema, as the stage does before any work. A block that cannot be run here is
marked in the text, ``<!-- not run: why -->``. The stages have their own tests.
"""

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override

from mrtask.cli import STAGES
from mrtask.suite.score import Request
from pipeline import clean
from pipeline.app.main import _for_hydra
from pipeline.app.map_task import ScenarioOptions, scenario_files
from pipeline.app.tool import load_options, overrides
from pipeline.live.process import read_options as live_options
from pipeline.live.ros import read_options as ros_options
from pipeline.scenario import VERBATIM
from simulators.pyrobosim.__main__ import read_options
from tests.pipeline.configured import configured
from tests.pipeline.test_own_map import CONTAINERS, write_lab

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "datasets" / "README.md"])
FENCE = re.compile(
    r"(?:<!-- not run: (?P<why>[^>]+) -->\n)?^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
ELSEWHERE = {
    "pip",
    "git",
    "docker",
    "kubectl",
    "sbatch",
    "srun",
    "ray",
    "cd",
    "export",
    "duckdb",
    "ls",
    "open",
    "python3",
}
"""Commands of other projects; their arguments are not checked."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    text: str
    not_run: str | None


def blocks() -> Iterator[Block]:
    for path in PAGES:
        content = path.read_text()
        for found in FENCE.finditer(content):
            line = content[: found.start()].count("\n") + 1
            text = re.sub(rf"^{found['indent']}", "", found["text"], flags=re.MULTILINE)
            yield Block(path.relative_to(ROOT).as_posix(), line, found["language"], text, found["why"])


BLOCKS = list(blocks())


def of(*languages: str) -> list[pytest.param]:  # type: ignore[valid-type]
    chosen = [block for block in BLOCKS if block.language in languages and block.not_run is None]
    return [pytest.param(block, id=f"{block.page}:{block.line}") for block in chosen]


def test_every_block_says_what_it_is() -> None:
    known = {"bash", "python", "yaml", "text", "toml", "dockerfile"}
    assert [(block.page, block.line) for block in BLOCKS if block.language not in known] == []
    assert len([block for block in BLOCKS if block.language in ("bash", "python")]) > 20


@pytest.mark.parametrize("guide", sorted((ROOT / "docs" / "howto").glob("*.md")), ids=lambda path: path.stem)
def test_a_guide_opens_with_its_command(guide: Path) -> None:
    title, _, rest = guide.read_text().partition("\n\n")
    assert title.startswith("# ") and FENCE.match(rest), f"{guide.name}: no command right below the title"


@pytest.mark.usefixtures("homes_made_once")
@pytest.mark.parametrize("block", of("python"))
def test_programs_run(block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block.text, f"{block.page}:{block.line}", "exec"), {"__name__": "documentation"})


@pytest.mark.parametrize("block", of("yaml"))
def test_yaml_is_yaml(block: Block) -> None:
    assert list(yaml.safe_load_all(block.text))


@pytest.mark.parametrize("block", of("bash"))
def test_commands_are_understood(block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    commands = list(_commands(block.text, tmp_path))
    assert commands
    for command in commands:
        _check(command, tmp_path)


def _commands(script: str, folder: Path) -> Iterator[list[str]]:
    """Yield the commands that a shell would run, one after the other, with their arguments as the shell passes them."""
    called = sorted({word for word in re.findall(r"[\w./-]+", script) if re.fullmatch(r"[a-z][\w-]*", word)})
    log = folder / "calls"
    functions = "".join(
        f'{name}() {{ printf "%s\\0" {name} "$@" >>"{log}"; printf "\\1\\0" >>"{log}"; }}\n'
        for name in called
        if name in {"make", "python", "mrtask", *ELSEWHERE} - {"export"}
    )
    done = subprocess.run(
        ["bash", "-euc", f"{functions}{script}"], cwd=folder, capture_output=True, text=True, env=_environment()
    )
    assert done.returncode == 0, done.stderr
    assert "command not found" not in done.stderr, done.stderr
    call: list[str] = []
    for word in log.read_text().split("\0")[:-1]:
        if word == "\1":
            yield call
            call = []
        else:
            call.append(word)


def _environment() -> dict[str, str]:
    """Leave out the arguments of `make test ARGS=...`, which `make` passes on."""
    return {name: value for name, value in os.environ.items() if name not in {"BASH_ENV", "ARGS", "MAKEFLAGS"}}


def _check(command: list[str], folder: Path) -> None:
    program, *arguments = command
    if program == "make":
        _check_make(arguments, folder)
    elif program == "mrtask" and arguments[0] in STAGES:
        _check_overrides(arguments[1:])
    elif program == "mrtask" and arguments[0] == "score":
        Request.parse(arguments[1:])
    elif program == "mrtask" and arguments[0] == "champion":
        assert all(one.isdecimal() for one in arguments[1:])
    elif program == "mrtask" and arguments[0] == "clean":
        clean._options(arguments[1:])
    elif program == "mrtask" and arguments[0] == "status":
        assert len(arguments) == 2
    elif program == "mrtask":
        assert arguments == ["doctor"]
    elif program == "python" and arguments[:2] == ["-m", "pipeline.live"]:
        write_lab(folder, CONTAINERS)
        live_options(arguments[2:])
    elif program == "python" and arguments[:2] == ["-m", "pipeline.live.ros"]:
        ros_options(arguments[2:])
    elif program == "python" and arguments[:2] == ["-m", "pipeline.live.recording"]:
        assert len(arguments) == 4
    elif program == "python" and arguments[:2] == ["-m", "pipeline.scenario"]:
        given = overrides(arguments[2:], VERBATIM)
        load_options(ScenarioOptions, scenario_files(given, "scenario.yaml"), given)
    elif program == "python" and arguments[0] == "-m" and arguments[1].startswith("pipeline."):
        assert arguments[1].removeprefix("pipeline.") in STAGES
        _check_overrides(arguments[2:])
    elif program == "python" and arguments[:2] == ["-m", "simulators.pyrobosim"]:
        read_options(arguments[2:])
    elif program == "python" and arguments[0].endswith(".py"):
        assert (ROOT / arguments[0]).is_file(), arguments[0]
        flags = {one for one in arguments if one.startswith("--")}
        assert all(flag in (ROOT / arguments[0]).read_text() for flag in flags)
    elif program == "python":
        assert arguments[:2] == ["-m", "pytest"] and all((ROOT / one).exists() for one in arguments[2:3]), command
    else:
        assert program in ELSEWHERE, f"unknown command {program}; mark the block `<!-- not run: why -->`"


def _check_make(arguments: list[str], folder: Path) -> None:
    """Check that the target exists and that its recipe is one of the commands above."""
    (folder / ".installed").touch()
    dry = subprocess.run(
        ["make", "-n", f"VENV={folder}", *arguments], cwd=ROOT, capture_output=True, text=True, env=_environment()
    )
    assert dry.returncode == 0, dry.stderr
    for line in dry.stdout.splitlines():
        if " -m pipeline.reproduce" in line:
            _check_overrides(shlex.split(line)[3:])


def _check_overrides(arguments: list[str]) -> None:
    arguments = [_for_hydra(one) for one in arguments if one not in ("-m", "--help", "--cfg", "job", "--dry-run")]
    overrides = OverridesParser.create().parse_overrides(arguments)
    configured(*map(_first, overrides))


def _first(override: Override) -> str:
    """Return the override, with the first value only if it is a sweep."""
    if not override.is_sweep_override():
        return str(override.input_line)
    return f"{override.key_or_group}={next(iter(override.sweep_string_iterator()))}"


def test_the_files_for_clusters_are_well_formed(tmp_path: Path) -> None:
    script = ROOT / "docs" / "howto" / "cluster" / "slurm.sh"
    assert subprocess.run(["bash", "-n", str(script)], capture_output=True).returncode == 0
    command = next(line for line in script.read_text().splitlines() if line.startswith("mrtask evaluate "))
    words = shlex.split(command.removesuffix("&"))[2:]
    _check_overrides([one.replace("$address", "10.0.0.1:6379") for one in words if one != "$@"])
    before_ray, *_ = script.read_text().partition("ray start")
    assert "export RAY_AUTH_MODE=token RAY_AUTH_TOKEN\n" in before_ray
    _check_the_array(ROOT / "docs" / "howto" / "cluster" / "slurm_array.sh", tmp_path)
    job = yaml.safe_load((ROOT / "docs" / "howto" / "cluster" / "kuberay.yaml").read_text())
    assert job["spec"]["rayClusterSpec"]["authOptions"] == {"mode": "token"}
    assert f"ray=={job['spec']['rayClusterSpec']['rayVersion']}\n" in (ROOT / "constraints.txt").read_text()
    program, stage, *overrides = job["spec"]["entrypoint"].split()
    assert (program, stage) == ("mrtask", "evaluate")
    _check_overrides(overrides)
    groups = [job["spec"]["rayClusterSpec"]["headGroupSpec"], *job["spec"]["rayClusterSpec"]["workerGroupSpecs"]]
    images = {group["template"]["spec"]["containers"][0]["image"] for group in groups}
    assert len(images) == 1  # one version of mrtask everywhere


def _check_the_array(script: Path, folder: Path) -> None:
    """Run each job of the array with a command in mrtask's place that says what it was given."""
    (folder / "bin").mkdir()
    (folder / "bin" / "activate").write_text(f'PATH="{folder}/bin:$PATH"')
    (folder / "bin" / "mrtask").write_text('#!/bin/bash\nprintf "%s\\n" "$@"')
    (folder / "bin" / "mrtask").chmod(0o755)
    last = int(re.findall(r"^#SBATCH --array=0-(\d+)$", script.read_text(), re.MULTILINE)[0])
    cells = set()
    for number in range(last + 1):
        environment = {**os.environ, "MRTASK_VENV": str(folder), "SLURM_ARRAY_TASK_ID": str(number)}
        job = ["bash", str(script), "seed=1"]
        stage, flag, *overrides = subprocess.run(
            job, env=environment, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        assert (stage, flag, overrides[-1]) == ("evaluate", "-m", "seed=1")
        parsed = OverridesParser.create().parse_overrides(overrides)
        assert [one.is_sweep_override() for one in parsed] == [True, True, False]
        [values] = BasicSweeper.split_arguments(parsed, max_batch_size=None)
        _check_overrides(values[0])
        cells.add(tuple(values[0]))
    assert len(cells) == last + 1
    one_more = {**environment, "SLURM_ARRAY_TASK_ID": str(last + 1)}
    assert subprocess.run(["bash", str(script)], env=one_more, capture_output=True).returncode, "the array is too short"
