"""Build the wheel; everything else about the package is in ``pyproject.toml``.

A checkout has two packages, ``mrtask`` and ``pipeline``. Installed beside other software, a top-level package with
such a common name could overwrite another one or be overwritten. So the wheel holds ``mrtask`` alone: ``pipeline``
becomes ``mrtask.pipeline``, renamed in all its files, and ``conf`` becomes data of the package. Messages that name
``python -m pipeline.train`` name ``mrtask train`` instead. Checkouts and editable installations do not change.
tests/test_wheel.py builds a wheel and runs it.
"""

import re
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

COMMAND = re.compile(r"python -m pipeline\.([a-z_]+)(?!\w|\.\w)")
"""A stage or tool as messages name it in a checkout; installed, it is a subcommand of ``mrtask``."""
PACKAGE = re.compile(r"(?<![\w./-])pipeline(?=\.[a-z_]| import\b)")
"""The package's name before a module's name (in imports, in quotes, after ``python -m``) or in ``from ... import``."""
RENAMED_SUFFIXES = {".py", ".yaml", ".jinja"}
RENAMED = ("pipeline", "conf", "analysis")
"""The folders whose files are renamed. None of them decides a result, so rows have the same hash of the code."""


class BuildPy(build_py):
    """Copy the packages into the build, and rename one of them if the build is a wheel."""

    def run(self) -> None:
        """Build."""
        if not self.editable_mode:
            shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()
        if not self.editable_mode:
            build = Path(self.build_lib)
            shutil.move(build / "pipeline", build / "mrtask" / "pipeline")
            shutil.copytree("conf", build / "mrtask" / "conf")
            for folder in RENAMED:
                for path in (build / "mrtask" / folder).rglob("*"):
                    if path.suffix in RENAMED_SUFFIXES:
                        path.write_text(renamed(path.read_text(encoding="utf-8")), encoding="utf-8")


def renamed(text: str) -> str:
    """Replace the names of the checkout in a file's text: ``pipeline`` the package, and the commands to start it."""
    return PACKAGE.sub("mrtask.pipeline", COMMAND.sub(r"mrtask \1", text))


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildPy})
