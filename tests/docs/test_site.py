"""The site builds without a warning, its pages link to what exists, and its generated pages are up to date."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README_WORDS = 1000
LINK = re.compile(r"\[[^\]]*\]\((?!https?:|mailto:)([^)\s#]+)(#[\w-]+)?\)")


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    pages = [path.relative_to(tmp_path / "site") for path in (tmp_path / "site").rglob("index.html")]
    assert len(pages) > 10
    assert not list((tmp_path / "site").rglob("*.py[co]")), "what Python left beside the pages is published"
    home = (tmp_path / "site" / "index.html").read_text()
    assert not re.findall(r'(?:src|href)="https?://(?:fonts|cdn|unpkg)[^"]*"', home)  # read offline, too


def test_the_configuration_page_is_made_from_the_present_schema() -> None:
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs" / "configuration_reference.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    told = "run python docs/configuration_reference.py > docs/configuration.md"
    assert (ROOT / "docs" / "configuration.md").read_text() == module.page(), told


def test_the_readme_stays_short() -> None:
    assert len((ROOT / "README.md").read_text().split()) <= README_WORDS


@pytest.mark.parametrize("page", sorted(path.name for path in ROOT.glob("*.md")))
def test_links_of_pages_beside_the_site_lead_somewhere(page: str) -> None:
    for target, _ in LINK.findall((ROOT / page).read_text()):
        assert (ROOT / target).exists(), target


def test_files_and_tests_that_pages_name_exist() -> None:
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        for name in re.findall(
            r"`((?:mrtask|pipeline|tests|conf|examples|benchmarks|docs|simulators)/[\w./-]+)`", path.read_text()
        ):
            assert (ROOT / name).exists(), f"{path.name}: {name}"
