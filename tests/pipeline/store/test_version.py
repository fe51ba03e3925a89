"""What a worker's code is compared by."""

from pathlib import Path

import pytest

from pipeline.store import version

PLANNER = "import helper\n\n\nclass Mine:\n    pass\n"


def expected(modules: tuple[str, ...], **changed: str) -> dict[str, str]:
    return {**version.worker_code(modules), **changed}


def test_equal_code_has_no_differences_and_others_are_named() -> None:
    modules = ("pipeline.episodes.worker",)
    assert version.differences_in_code(expected(modules), modules) == []
    other = expected(modules, numba="0.1", **{"mrtask.execution": "0" * 16})
    here = version.public_version("numba")
    assert version.differences_in_code(other, modules) == [
        "other code in mrtask.execution",
        f"numba {here} instead of 0.1",
    ]


def test_an_own_planner_counts_with_what_it_imports_from_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "helper.py").write_text("WEIGHT = 1\n")
    before = expected(("mine",))
    version.worker_code.cache_clear()
    (tmp_path / "helper.py").write_text("WEIGHT = 2\n")
    assert version.differences_in_code(before, ("mine",)) == ["other code in mine"]
    version.worker_code.cache_clear()
    (tmp_path / "mine.py").unlink()
    assert version.differences_in_code(before, ("mine",)) == ["no mine"]
    version.worker_code.cache_clear()


def test_the_code_of_workers_is_the_code_that_decides_rows() -> None:
    parts = version.worker_code(("pipeline.episodes.worker", "pipeline.backends.pool"))
    assert {f"mrtask.{name}" for name in version.RESULT_SOURCES} <= parts.keys()
    assert {"numba", "numpy", "torch", "python", "pipeline.episodes.worker", "pipeline.backends.pool"} <= parts.keys()
    assert version.MISSING not in parts.values()
