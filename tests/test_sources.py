"""Which files decide a result: what changes a hash and what does not."""

import shutil
from pathlib import Path

import pytest

from mrtask.sources import ROOT, hash_folders, hash_module, module_files

MAPS = "mrtask.maps.cache"
GENERATOR = "mrtask.homes.generator.house"
READER = "mrtask.homes.procthor"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder with a copy of the package, free to be changed."""
    shutil.copytree(ROOT / "mrtask", tmp_path / "mrtask", ignore=shutil.ignore_patterns("__pycache__", "*.nb?"))
    return tmp_path


def add_line(path: Path) -> None:
    path.write_text(path.read_text() + "\n# another line\n")


@pytest.mark.parametrize(
    ("module", "file", "matters"),
    [
        (MAPS, "maps/home_map.py", True),
        (MAPS, "maps/distance_fields.py", True),
        (MAPS, "homes/home.py", True),
        (MAPS, "maps/cache.py", True),
        (MAPS, "maps/ros_map.py", False),
        (MAPS, "homes/procthor.py", False),
        (MAPS, "analysis/drawing/floor_plans.py", False),
        (MAPS, "planning/pouct.py", False),
        (GENERATOR, "homes/catalogue.yaml", True),
        (GENERATOR, "homes/catalogue.py", True),
        (GENERATOR, "homes/contents.py", True),
        (GENERATOR, "homes/generator/furnishing.py", True),
        (GENERATOR, "homes/procthor.py", False),
        (GENERATOR, "homes/split.py", False),
        (GENERATOR, "homes/download.py", False),
        (READER, "homes/home.py", True),
        (READER, "homes/catalogue.yaml", True),
        (READER, "homes/generator/house.py", False),
    ],
)
def test_a_changed_line_matters_where_the_module_uses_it(root: Path, module: str, file: str, matters: bool) -> None:
    before = hash_module(module, root)
    add_line(root / "mrtask" / file)
    assert (hash_module(module, root) != before) == matters


def test_the_copy_has_the_hash_of_the_original(root: Path) -> None:
    assert hash_module(MAPS, root) == hash_module(MAPS)
    assert hash_folders("mrtask/maps", root=root) == hash_folders("mrtask/maps")


def test_imports_are_followed_however_they_are_written(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "inner").mkdir(parents=True)
    sources = {
        "__init__.py": "",
        "top.py": "import json\nimport package.plain as alias\nfrom package import named\nfrom . import relative\n",
        "plain.py": "def late():\n    from package.inner.deep import thing\n",
        "named.py": "import package.top\n",
        "relative.py": "",
        "inner/__init__.py": "from .beside import thing\n",
        "inner/beside.py": "from ..from_below import thing\n",
        "inner/deep.py": "thing = 1\n",
        "inner/deep.yaml": "data: 1\n",
        "from_below.py": "thing = 1\n",
        "unused.py": "",
        "json.py": "",
    }
    for name, text in sources.items():
        (package / name).write_text(text)
    found = {path.relative_to(package).as_posix() for path in module_files("package.top", tmp_path)}
    assert found == sources.keys() - {"unused.py", "json.py"}


def test_a_renamed_or_moved_file_is_another_source(root: Path) -> None:
    before = hash_folders("mrtask/tasks", root=root)
    folder = root / "mrtask" / "tasks"
    (folder / "formula.py").rename(folder / "formulas.py")
    assert hash_folders("mrtask/tasks", root=root) != before


def test_names_that_are_nowhere_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"no module mrtask\.nowhere in"):
        hash_module("mrtask.nowhere")
    (tmp_path / "empty").mkdir()
    for folder in ("empty", "missing"):
        with pytest.raises(FileNotFoundError, match=f"no sources in .*{folder}"):
            hash_folders(folder, root=tmp_path)
