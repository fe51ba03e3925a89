"""A page's answer to its question."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Findings:
    """``verdict`` answers in a word or two, ``headline`` in a sentence; the rest adds detail and caution."""

    verdict: str
    headline: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
