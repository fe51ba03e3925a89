"""Builds the wheel; everything else about the package is in ``pyproject.toml``.

A checkout has two packages, ``mrtask`` and ``pipeline``. Installed beside others, a top-level package of so common a
name would overwrite another or be overwritten, so the wheel holds ``mrtask`` alone: ``pipeline`` becomes
``mrtask.pipeline``, by name in every file of it, and ``conf`` becomes data of the package. A checkout and an editable
installation stay as they are. tests/test_wheel.py builds a wheel and runs it.
"""

import re
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

PACKAGE = re.compile(r"(?<![\w./-])pipeline(?=\.[a-z_]| import\b)")
"""The package's name in front of a module's (in imports, in quotes, after ``python -m``) or in ``from ... import``."""
RENAMED_SUFFIXES = {".py", ".yaml"}


class BuildPy(build_py):
    """Copies the packages into the build, and in a wheel's build renames one."""

    def run(self) -> None:
        """The build."""
        if not self.editable_mode:
            shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()
        if not self.editable_mode:
            build = Path(self.build_lib)
            shutil.move(build / "pipeline", build / "mrtask" / "pipeline")
            shutil.copytree("conf", build / "mrtask" / "conf")
            for folder in ("pipeline", "conf"):
                for path in (build / "mrtask" / folder).rglob("*"):
                    if path.suffix in RENAMED_SUFFIXES:
                        path.write_text(renamed(path.read_text(encoding="utf-8")), encoding="utf-8")


def renamed(text: str) -> str:
    """A file's text with ``mrtask.pipeline`` for ``pipeline``."""
    return PACKAGE.sub("mrtask.pipeline", text)


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildPy})
