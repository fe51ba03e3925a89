"""Homes of the made-up world, their dataset, and a cache of name embeddings."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from mrtask.homes.home import Home
from mrtask.likelihood.dataset import Dataset, build_dataset
from tests.likelihood.made_up_world import TRUE_PROBS, Contents, draw_homes, make_home


@pytest.fixture(scope="session")
def home_of() -> Callable[[int, Contents], Home]:
    """``make_home``."""
    return make_home


@pytest.fixture(scope="session")
def true_probs() -> dict[tuple[str, str], dict[str, float]]:
    """``TRUE_PROBS``."""
    return TRUE_PROBS


@pytest.fixture(scope="session")
def made_up_homes() -> dict[str, list[Home]]:
    """Homes of the made-up world by split."""
    return {"train": draw_homes(120, 1), "validation": draw_homes(40, 2), "test": draw_homes(80, 3)}


@pytest.fixture(scope="session")
def made_up_dataset(made_up_homes: dict[str, list[Home]]) -> Dataset:
    """The dataset of the made-up homes."""
    return build_dataset(made_up_homes, source="made-up", seed=0, code_version="test")


@pytest.fixture(scope="session")
def embedding_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache of embeddings for the session, so that the embedding model is loaded once."""
    return tmp_path_factory.mktemp("embeddings")


@pytest.fixture(autouse=True, scope="session")
def _few_threads() -> None:
    torch.set_num_threads(1)
