"""The wheel: one package, with configuration, that runs the library and the stages without a checkout."""

import ast
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from mrtask import cli
from mrtask.cli import STAGES

ROOT = Path(__file__).resolve().parents[1]
PACKED = ("mrtask", "pipeline", "conf")
NOT_IN_THE_LIBRARY = (
    "ray", "mlflow", "torch", "hydra", "omegaconf", "sentence_transformers", "transformers", "sklearn", "fsspec",
    "psutil",
)  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the wheel installs."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in PACKED:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.nb?"))
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", str(built), str(source)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(next(built.glob("mrtask-*.whl"))) as wheel:
        wheel.extractall(folder)
    return folder


def run(site: Path, cwd: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python with the wheel's content in front of the checkout's, in an empty folder."""
    environment = os.environ | {"PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, timeout=400
    )


def test_it_installs_one_package_with_its_data(site: Path) -> None:
    assert {path.name for path in site.iterdir() if not path.name.endswith(".dist-info")} == {"mrtask"}
    for folder, packed in (("mrtask", ""), ("pipeline", "pipeline"), ("conf", "conf")):
        files = {path.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*") if path.is_file()}
        files = {path for path in files if "__pycache__" not in path.parts and path.suffix not in (".nbi", ".nbc")}
        assert {path for path in files if not (site / "mrtask" / packed / path).is_file()} == set()
    info = next(site.glob("*.dist-info"))
    assert {path.name for path in (info / "licenses").iterdir()} == {"LICENSE", "NOTICE"}


def test_nothing_in_it_names_the_checkouts_package(site: Path) -> None:
    for path in (site / "mrtask").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.partition(".")[0] == "pipeline"], path
    assert "_target_: mrtask.pipeline." in (site / "mrtask" / "conf" / "config.yaml").read_text()


def test_commands_in_its_messages_are_those_that_it_installs(site: Path) -> None:
    named = re.compile(rf"python -m (mrtask\.)?pipeline\.({'|'.join(cli.commands())})(?!\w|\.\w)")
    files = [path for path in (site / "mrtask").rglob("*") if path.suffix in (".py", ".yaml", ".jinja")]
    assert {path: found[0] for path in files if (found := named.search(path.read_text()))} == {}
    said = (site / "mrtask" / "pipeline" / "backends" / "registry.py").read_text()
    assert "train one with mrtask train, " in said
    live = (site / "mrtask" / "pipeline" / "live" / "ros.py").read_text()
    assert "    python -m mrtask.pipeline.live.ros " in live and "is mrtask live running" in live


def test_the_library_needs_none_of_the_pipelines_packages(site: Path, tmp_path: Path) -> None:
    program = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {(*NOT_IN_THE_LIBRARY, "pipeline")}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
import mrtask
assert mrtask.__file__.startswith({str(site)!r})
homes = list(mrtask.generate_homes(3, seed=9, size_classes=["small"]))
likelihood = mrtask.fit_on_homes(mrtask.generate_homes(4))
rows = mrtask.run_experiment(homes, ["nonlearned_myopic"], likelihood, robots=[1], trials_per_cell=2)
print(*rows.status)
"""
    done = run(site, tmp_path, "-c", program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["accepted", "accepted"]


def test_stages_run_from_it(site: Path, tmp_path: Path) -> None:
    refused = run(site, tmp_path, "-m", "mrtask.cli", "reproduced")
    assert refused.returncode == 2 and "no command 'reproduced'" in refused.stderr
    homes = ("homes.train=3", "homes.validation=1", "homes.test=2", "model=frequency")
    episodes = ("evaluation.planners=[nonlearned_myopic]", "evaluation.trials_per_cell=1", "evaluation.robots=[1]")
    arguments = [*homes, *episodes, "evaluation.size_classes=[small]", "output_dir=out", "cluster.cpus=1", "pdf=true"]
    done = run(site, tmp_path, "-m", "mrtask.cli", "reproduce", *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "out" / "report" / "index.html").is_file()
    assert list((tmp_path / "out" / "episodes").glob("*.parquet"))
    for kind, start in (("pdf", b"%PDF-"), ("svg", b"<?xml")):
        pictures = [path.read_bytes() for path in (tmp_path / "out" / "report" / "figures").glob(f"*.{kind}")]
        assert len(pictures) > 2 and all(one.startswith(start) and len(one) > 3000 for one in pictures)


def test_the_command_has_every_stage() -> None:
    stages = {path.stem for path in (ROOT / "pipeline").glob("*.py") if "\nSTAGE = " in path.read_text()}
    assert set(STAGES) == stages


def test_importing_the_library_is_light(tmp_path: Path) -> None:
    heavy = (*NOT_IN_THE_LIBRARY, "pandas", "numba", "scipy", "matplotlib", "shapely", "pipeline")
    code = f"import sys, mrtask; print(sorted(set({heavy}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    names = "import sys, mrtask; all_of = [getattr(mrtask, name) for name in dir(mrtask)]; assert len(all_of) > 30"
    code = f"{names}; print(sorted(set({NOT_IN_THE_LIBRARY}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_name_that_the_library_lacks_is_told_with_those_it_has() -> None:
    import mrtask

    with pytest.raises(AttributeError, match=r"no attribute 'Hom'; it has .*Home"):
        mrtask.Hom  # noqa: B018
