"""A small made-up world whose true likelihoods are known, and homes drawn from it."""

from collections.abc import Mapping, Sequence

import numpy as np

from mrtask.homes.home import Container, Home, Room

Contents = Sequence[tuple[str, str, Sequence[str]]]
"""(container type, room type, objects) of each container."""
Likelihoods = Mapping[tuple[str, str], Mapping[str, float]]
"""(container type, room type) -> object -> probability."""

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


def draw_homes(number: int, seed: int, likelihoods: Likelihoods = TRUE_PROBS) -> list[Home]:
    """Homes with one container of each kind, filled by these probabilities."""
    rng = np.random.default_rng(seed)
    return [
        make_home(
            seed * 1000 + index,
            [
                (container, room, [name for name, prob in probs.items() if rng.random() < prob])
                for (container, room), probs in likelihoods.items()
            ],
        )
        for index in range(number)
    ]
