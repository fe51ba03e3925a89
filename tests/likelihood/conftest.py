"""A small made-up world whose true likelihoods are known, homes drawn from it, and a cache of name embeddings."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from mrtask.homes.home import Container, Home, Room
from mrtask.likelihood.dataset import Dataset, build_dataset

Contents = Sequence[tuple[str, str, Sequence[str]]]

TRUE_PROBS = {
    ("Fridge", "Kitchen"): {"Apple": 0.8, "Bread": 0.5, "Book": 0.02, "Pillow": 0.02, "Mug": 0.3},
    ("DiningTable", "Kitchen"): {"Apple": 0.4, "Bread": 0.6, "Book": 0.2, "Pillow": 0.02, "Mug": 0.6},
    ("Bed", "Bedroom"): {"Apple": 0.02, "Bread": 0.02, "Book": 0.4, "Pillow": 0.9, "Mug": 0.05},
    ("Sofa", "LivingRoom"): {"Apple": 0.02, "Bread": 0.02, "Book": 0.3, "Pillow": 0.6, "Mug": 0.1},
    ("Desk", "Bedroom"): {"Apple": 0.05, "Bread": 0.02, "Book": 0.7, "Pillow": 0.02, "Mug": 0.5},
}


def make_home(number: int, contents: Contents) -> Home:
    """A home of ``(container type, room type, objects)``; ``number`` alone makes it another home than its like."""
    rooms = sorted({room for _, room, _ in contents})
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    return Home(
        source="made-up",
        rooms=tuple(Room(f"room|{room}", room, (*square[:2], (1.0, 1.0 + number), (0.0, 1.0))) for room in rooms),
        doors=(),
        containers=tuple(
            Container(f"{kind}|{index}", kind, f"room|{room}", square, tuple(sorted(objects)))
            for index, (kind, room, objects) in enumerate(contents)
        ),
        obstacles=(),
    )


def draw_homes(number: int, seed: int) -> list[Home]:
    """Homes with one container of each kind, filled by ``TRUE_PROBS``."""
    rng = np.random.default_rng(seed)
    return [
        make_home(
            seed * 1000 + index,
            [
                (container, room, [name for name, prob in probs.items() if rng.random() < prob])
                for (container, room), probs in TRUE_PROBS.items()
            ],
        )
        for index in range(number)
    ]


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
