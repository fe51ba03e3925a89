"""Contents of homes drawn from people's votes: the files of votes and the options, as a record keeps them."""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import numpy as np

from mrtask.homes import refurnish
from mrtask.homes.download import HOUSEKEEP, SPLITS_FILE, VOTES_FILE, DownloadError, fetch
from mrtask.homes.home import Home
from mrtask.homes.receptacles import BUNDLED_TABLE, Match, match_homes, read_table
from mrtask.homes.refurnish import Refurnisher
from mrtask.homes.votes import ALL, SPLITS_SHA256, Votes, read_splits, read_votes, split_objects
from mrtask.likelihood.embeddings import nearest_name
from mrtask.sources import hash_module
from pipeline.base import console
from pipeline.base.config import UserError
from pipeline.base.sections import Contents
from pipeline.base.values import Section

FOLDER = "housekeep"


class VotedContents(Section):
    """Contents drawn from the votes in ``file``, of the objects of one split or all, as `Refurnisher` draws them."""

    file: Path
    splits: Path | None
    """Only where the objects are those of one split."""
    objects: Literal["all", "train", "val", "test"]
    table: Path
    misplaced: float
    seed: int
    embedding: str

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that it reads."""
        return (self.file, *([self.splits] if self.splits else []), self.table)

    def votes(self) -> Votes:
        """Return the votes on the objects that may lie in the homes; raises `VotesError`."""
        return _read_votes(self)

    def furnish(self, homes: Sequence[Home]) -> tuple[Home, ...]:
        """Return the homes in their order, refurnished; a home's contents depend only on the home and the seed."""
        refurnisher = Refurnisher(self.votes(), self.match(homes), self.misplaced)
        return tuple(
            refurnisher.refurnish(home, np.random.default_rng([self.seed, int(home.id, 16)])) for home in homes
        )

    def match(self, homes: Sequence[Home]) -> Match:
        """Return which places of the votes the homes' containers stand for."""
        nearest = partial(nearest_name, model=self.embedding)
        return match_homes(homes, self.votes().placements, read_table(self.table), nearest)

    def key(self) -> list[object]:
        """Return what decides the contents besides the files."""
        options = self.model_dump(mode="json", exclude={"file", "splits", "table"})
        return [options, hash_module(refurnish.__name__)]


def voted_contents(options: Contents, datasets_dir: Path) -> VotedContents:
    """Return the configured files, downloaded where none are given, and options, checked.

    Raises:
        InputError: a file is missing, damaged, unsafe or cannot be downloaded.
    """
    file, _ = _votes_in(options, datasets_dir)
    splits = None if options.objects == ALL else _splits_in(options, datasets_dir)[0]
    found = VotedContents(
        file=file, splits=splits, table=options.table or BUNDLED_TABLE,
        **options.model_dump(include={"objects", "misplaced", "seed", "embedding"}),
    )  # fmt: skip
    found.votes()
    read_table(found.table)
    return found


def needs_download(options: Contents, datasets_dir: Path) -> bool:
    """Tell whether a file of the configured votes is neither given nor downloaded yet."""
    wanted = {VOTES_FILE: options.file} | ({} if options.objects == ALL else {SPLITS_FILE: options.splits})
    return any(path is None and not (datasets_dir / FOLDER / name).is_file() for name, path in wanted.items())


def votes_by_split(options: Contents, datasets_dir: Path) -> dict[str, Votes]:
    """Return the configured votes on the objects of each split; raises what `voted_contents` does."""
    _, votes = _votes_in(options, datasets_dir)
    _, splits = _splits_in(options, datasets_dir)
    return {name: votes.of(objects) for name, objects in splits.items()}


def _votes_in(options: Contents, datasets_dir: Path) -> tuple[Path, Votes]:
    file = options.file or _downloaded(VOTES_FILE, datasets_dir)
    return file, read_votes(file, options.sha256 if options.file else None)


def _splits_in(options: Contents, datasets_dir: Path) -> tuple[Path, dict[str, tuple[str, ...]]]:
    path = options.splits or _downloaded(SPLITS_FILE, datasets_dir)
    return path, read_splits(path, None if options.splits else SPLITS_SHA256)


def say_match(contents: VotedContents, homes: Sequence[Home]) -> None:
    """Say which containers of the homes were matched by name, and which stay empty."""
    match = contents.match(homes)
    if match.by_name:
        console.line("matched by name: " + ", ".join(f"{name} as {found}" for name, found in match.by_name.items()))
    if match.unknown:
        console.line(f"the table of receptacles has names without votes: {', '.join(match.unknown)}")
    if match.unmatched:
        console.line(f"these have no votes and stay empty: {', '.join(match.unmatched)} (contents.table=...)")


def _downloaded(name: str, datasets_dir: Path) -> Path:
    try:
        return fetch(HOUSEKEEP[name], datasets_dir / FOLDER / name)
    except DownloadError as error:
        key = "contents.file" if name == VOTES_FILE else "contents.splits"
        raise UserError(f"where people put things: {error}, or named by {key}=...") from error


@lru_cache(maxsize=4)
def _read_votes(contents: VotedContents) -> Votes:
    votes = read_votes(contents.file)
    if contents.splits is None:
        return votes
    return votes.of(split_objects(read_splits(contents.splits), contents.objects))
