"""The project as a whole: what it installs, what its layers may know, what its Makefile promises."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PINS = dict(
    line.split("==")
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if line and not line.startswith("#")
)


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def run(*command: str, cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
    everything = os.environ | environment
    return subprocess.run(command, cwd=cwd, env=everything, capture_output=True, text=True, timeout=300)


def test_every_package_is_installed_and_no_other() -> None:
    on_disk = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for top in ("mrtask", "pipeline")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert set(PYPROJECT["tool"]["setuptools"]["packages"]) == on_disk


def test_every_data_file_of_the_library_is_installed() -> None:
    patterns = PYPROJECT["tool"]["setuptools"]["package-data"]["*"]
    data = [path for path in (ROOT / "mrtask").rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")]
    data = [path for path in data if path.suffix not in (".nbi", ".nbc")]
    assert data
    assert [path for path in data if not any(path.match(pattern) for pattern in patterns)] == []


def test_every_dependency_is_pinned_to_one_version_of_no_special_build() -> None:
    project = PYPROJECT["project"]
    wanted = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    names = {canonical(re.split(r"[<>=\[ ]", requirement)[0]) for requirement in wanted}
    assert names - {project["name"]} <= {canonical(name) for name in PINS}
    assert all(re.fullmatch(r"[0-9][0-9a-z.]*", version) for version in PINS.values())
    assert PINS["torch"] == "2.13.0"


def test_processes_share_the_tests_by_group(request: pytest.FixtureRequest) -> None:
    if not getattr(request.config.option, "loadgroup", False):
        pytest.skip("needs several processes that share the tests by group, as those of `make test`")
    assert request.node.nodeid.endswith(f"@{Path(__file__).relative_to(ROOT)}")


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    return run(str(Path(sys.executable).with_name("lint-imports")), "--no-cache", cwd=folder, PYTHONPATH=str(folder))


def test_layers_and_tools_are_where_they_belong() -> None:
    done = lint_imports(ROOT)
    assert done.returncode == 0, done.stdout
    contracts = PYPROJECT["tool"]["importlinter"]["contracts"]
    assert len(contracts) >= 6 and f"{len(contracts)} kept, 0 broken" in done.stdout


def test_forbidden_imports_are_noticed(tmp_path: Path) -> None:
    for top in ("mrtask", "pipeline"):
        shutil.copytree(ROOT / top, tmp_path / top, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    smuggled = (
        ("mrtask/homes/smuggler.py", "import mrtask.planning.tree", "the library's layers"),
        ("mrtask/execution/smuggler.py", "import mrtask.bounds.assess", "the library's layers"),
        ("mrtask/bounds/smuggler.py", "import mrtask.analysis.page.style", "the library's layers"),
        ("mrtask/analysis/results/smuggler.py", "import mrtask.analysis.page.style", "the analysis draws"),
        ("mrtask/analysis/page/smuggler.py", "import mrtask.analysis.drawing.sheet", "the analysis draws"),
        ("mrtask/analysis/drawing/smuggler.py", "import mrtask.analysis.report.gap", "the analysis draws"),
        ("mrtask/analysis/studies/smuggler.py", "import mrtask.analysis.report.wins", "the analysis draws"),
        ("mrtask/analysis/report/smuggler.py", "import mrtask.analysis.studies.realism", "the analysis draws"),
        ("mrtask/maps/smuggler.py", "import mlflow", "the library knows nothing"),
        ("pipeline/backends/smuggler.py", "import ray", "only pipeline.backends' pool and nodes know ray"),
        ("pipeline/backends/smuggler.py", "import mlflow", "only pipeline.backends' runs, registry"),
        ("pipeline/store/layout.py", "import mrtask.analysis.report.report_page", "what is configured and kept"),
        ("mrtask/maps/cache.py", "import matplotlib", "workers start soon"),
        ("pipeline/app/smuggler.py", "import pipeline.report", "the pipeline's stages"),
        ("pipeline/episodes/smuggler.py", "import pipeline.app.stage", "the pipeline's stages"),
        ("pipeline/backends/smuggler.py", "import pipeline.inputs.homes", "the pipeline's stages"),
        ("pipeline/inputs/smuggler.py", "import pipeline.episodes.plan", "the pipeline's stages"),
        ("pipeline/homes.py", "import pipeline.dataset", "the pipeline's stages"),
        ("pipeline/store/smuggler.py", "import pipeline.backends.pool", "the pipeline's stages"),
        ("pipeline/base/smuggler.py", "import pipeline.store.rows", "the pipeline's stages"),
        ("pipeline/store/records.py", "import pipeline.store.artifacts", "no import goes in a circle"),
        ("mrtask/execution/trace.py", "def late(): import mrtask.execution.episode", "no import goes in a circle"),
    )
    for module, line, _ in smuggled:
        with (tmp_path / module).open("a") as file:
            file.write(f"\n{line}\n")
    (tmp_path / "pipeline" / "smuggler.py").touch()
    done = lint_imports(tmp_path)
    assert done.returncode == 1
    told = broken_contracts(done.stdout)
    for module, line, contract in smuggled:
        importer, imported = module.removesuffix(".py").replace("/", "."), line.rpartition(" ")[2]
        [about] = [text for name, text in told.items() if name.startswith(contract)]
        names = f"{importer} -> {imported}"
        if contract == "no import goes in a circle":  # told by their names in the package alone
            names = " -> ".join("." + name.rpartition(".")[2] for name in (importer, imported))
        assert re.search(re.escape(names) + r"\b", about), (module, line, about)
    [about] = [text for name, text in told.items() if name.startswith("the pipeline's stages")]
    assert re.search(r"^- smuggler\b|pipeline\.smuggler$", about, re.MULTILINE), about


def broken_contracts(said: str) -> dict[str, str]:
    """What import-linter says about each broken contract, by its name."""
    _, _, details = said.partition("Broken contracts")
    names = [contract["name"] for contract in PYPROJECT["tool"]["importlinter"]["contracts"]]
    parts = re.split(f"^({'|'.join(map(re.escape, names))})$", details, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_kernel_is_where_the_compilers_cache_looks_for_edits() -> None:
    from mrtask.sources import KERNEL_SOURCES

    kernel = re.compile(r"^(@compiled|@njit|import numba|from numba)", re.MULTILINE)
    compiled = [path for path in (ROOT / "mrtask").rglob("*.py") if kernel.search(path.read_text())]
    assert compiled and all(any((ROOT / source) in path.parents for source in KERNEL_SOURCES) for path in compiled)


def test_the_data_folder_is_no_package() -> None:
    """Libraries import one of its name; `tests/likelihood/test_embeddings.py` has them do so from here."""
    assert not list((ROOT / "datasets").rglob("*.py"))


class FakePython:
    """Stands in for Python, so that the Makefile's installation can be watched without one."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "calls"
        self.venv = folder / "venv"
        self.path = folder / "python"
        self.path.write_text(
            f"""#!/bin/sh
echo "$@" >> {self.log}
case "$*" in
  "-c "*) exit ${{FAKE_TOO_OLD:-0}} ;;
  "--version") echo Python 3.8.1 ;;
  "-m venv"*) mkdir -p {self.venv}/bin && cp "$0" {self.venv}/bin/python ;;
  "-m uv"*) exit ${{FAKE_UV:-${{FAKE_INSTALL:-0}}}} ;;
  *--editable*) exit ${{FAKE_INSTALL:-0}} ;;
esac
"""
        )
        self.path.chmod(0o755)

    def make(self, **environment: str) -> subprocess.CompletedProcess[str]:
        """``make install`` with it; the log holds the calls of this time only."""
        self.log.write_text("")
        return run("make", "install", f"PYTHON={self.path}", f"VENV={self.venv}", **environment)

    @property
    def installs(self) -> int:
        """How often the package was installed."""
        return self.log.read_text().count("--editable")


@pytest.fixture
def fake_python(tmp_path: Path) -> FakePython:
    return FakePython(tmp_path)


def test_installation_happens_once(fake_python: FakePython) -> None:
    first = fake_python.make()
    assert first.returncode == 0, first.stderr
    assert "-m venv" in fake_python.log.read_text() and fake_python.installs == 1
    assert fake_python.make().returncode == 0
    assert fake_python.log.read_text() == ""


def test_an_interrupted_installation_is_made_up_for(fake_python: FakePython) -> None:
    broken = fake_python.make(FAKE_INSTALL="1")
    assert broken.returncode != 0
    assert "the installation failed" in broken.stderr
    assert fake_python.make().returncode == 0
    assert fake_python.installs == 1


def test_where_uv_finds_no_way_pip_installs(fake_python: FakePython) -> None:
    assert fake_python.make().returncode == 0
    assert "-m pip install --no-build-isolation" not in fake_python.log.read_text()
    shutil.rmtree(fake_python.venv)
    made = fake_python.make(FAKE_UV="1")
    assert made.returncode == 0, made.stderr
    assert "-m pip install --no-build-isolation" in fake_python.log.read_text()


def test_an_old_python_is_refused_with_what_to_do(fake_python: FakePython) -> None:
    refused = fake_python.make(FAKE_TOO_OLD="1")
    assert refused.returncode != 0
    assert "needs Python 3.11 or newer; found: Python 3.8.1" in refused.stderr
    assert "make install PYTHON=" in refused.stderr
    assert not fake_python.venv.exists()


def test_readme_and_ci_run_the_same_tests() -> None:
    assert "make test" in (ROOT / "README.md").read_text()
    lines = (ROOT / ".ci" / "run").read_text().splitlines()
    assert {"make test || failed=1", 'nice -n 19 make lint >"$said" 2>&1 &', 'exit "$failed"'} <= set(lines)


def test_the_data_readme_lists_what_is_downloaded() -> None:
    from mrtask.homes.download import PROCTHOR_10K

    text = (ROOT / "datasets" / "README.md").read_text()
    for name, remote in PROCTHOR_10K.items():
        assert f"| {name} | {remote.size_bytes} | `{remote.sha256}` |" in text
