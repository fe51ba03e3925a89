"""Atomic writes, file hashes and the place of the cache."""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mrtask.files import default_cache_dir, replacing, sha256_of


def test_the_file_appears_at_the_end_of_the_block(tmp_path):
    path = tmp_path / "new" / "data.npy"
    with replacing(path) as temporary:
        temporary.write_bytes(b"whole")
        assert temporary.suffix == ".npy" and temporary.parent == path.parent and not path.exists()
    assert path.read_bytes() == b"whole"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "data"
    path.write_text("old")
    with pytest.raises(error), replacing(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_many_writers_of_one_file(tmp_path):
    path = tmp_path / "data"

    def write(number):
        with replacing(path) as temporary:
            temporary.write_text(str(number) * 10_000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(10)))
    text = path.read_text()
    assert len(text) == 10_000 and len(set(text)) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_the_hash_is_that_of_the_content(tmp_path):
    path = tmp_path / "data"
    path.write_bytes(bytes(range(256)) * 5000)
    assert sha256_of(path) == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({"MRTASK_CACHE_DIR": "/fast/disk", "XDG_CACHE_HOME": "/xdg"}, "/fast/disk"),
        ({"MRTASK_CACHE_DIR": "", "XDG_CACHE_HOME": "/xdg"}, "/xdg/mrtask"),
        ({"HOME": "/home/user"}, "/home/user/.cache/mrtask"),
    ],
)
def test_the_cache_is_where_the_environment_says(monkeypatch, environment, folder):
    for name in ("MRTASK_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert default_cache_dir() == Path(folder)
