"""Where people put things: ten people's votes on which receptacles of a room are right places for an object.

The data are those of Housekeep (Kant et al., "Housekeep: Tidying Virtual Households using Commonsense Reasoning", ECCV
2022) or your own in the same format: a ``.npy`` file that holds one pickled dict with ``ranks`` (int, ``[K, O, A]``: 1
is the best place, below 0 means that the object may lie there misplaced, 0 neither), ``objects`` (O names) and
``room_receptacles`` (K names ``room|receptacle``). A pickle can run any code when it is loaded, so this reader accepts
nothing in it but numpy arrays.
"""

import hashlib
import io
import json
import pickle
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.lib import format as npy
from numpy.typing import NDArray

from mrtask.arrays import Floats
from mrtask.errors import InputError
from mrtask.files import sha256_of

SPLITS = ("train", "val", "test")
ALL = "all"
SPLITS_SHA256 = "b227b3218df7178f81c9ad081e38ceb3d5962d65f94363b4edbcc7f023b8911a"
"""The hash of the names in the published split, whatever the form of the file (`splits_hash`)."""

Placement = tuple[str, str]
"""``(room, receptacle)``, in the data's own names."""

_SEPARATORS = re.compile(r"[\s_\-]+")


class VotesError(InputError):
    """Votes or splits that are missing, damaged, unsafe to read, or not the requested ones."""


@dataclass(frozen=True, eq=False)
class Votes:
    """The ``ranks [K, O, A]`` by A annotators for O object types (``RemoteControl``) and K ``placements``."""

    placements: tuple[Placement, ...]
    objects: tuple[str, ...]
    ranks: NDArray[np.int16]

    @property
    def share_right(self) -> Floats:
        """Return the share ``[K, O]`` of annotators for whom the place is right."""
        return np.asarray((self.ranks > 0).mean(axis=2))

    @property
    def share_misplaced(self) -> Floats:
        """Return the share ``[K, O]`` of annotators for whom the object may lie there misplaced."""
        return np.asarray((self.ranks < 0).mean(axis=2))

    def of(self, objects: Sequence[str]) -> "Votes":
        """Return the votes on some of the objects, in the given order.

        Raises:
            VotesError: nobody voted on one of them.
        """
        number = {name: index for index, name in enumerate(self.objects)}
        if unknown := [name for name in objects if name not in number]:
            raise VotesError(f"the votes have no object {unknown[0]!r}; are votes and splits of the same data?")
        return replace(self, objects=tuple(objects), ranks=self.ranks[:, [number[name] for name in objects]])


def object_type(name: str) -> str:
    """Return the data's name as an object type: ``remote_control`` -> ``RemoteControl``."""
    return "".join(word[:1].upper() + word[1:] for word in _SEPARATORS.split(name.strip()))


def read_votes(path: Path, sha256: str | None = None) -> Votes:
    """Read the votes in a file, which must have the ``sha256`` if one is given.

    Raises:
        VotesError: the votes cannot be used; the message says what is wrong and what to do.
    """
    if not path.is_file():
        raise VotesError(f"no such file of votes: {path}")
    if sha256 is not None and (found := sha256_of(path)) != sha256:
        raise VotesError(
            f"{path} has the sha256 {found}, expected {sha256}: it is damaged, or data of your own, which "
            "are read only without a checksum (contents.sha256=null)"
        )
    content = _unpickle(path)
    if not isinstance(content, Mapping):
        raise VotesError(f"{path}: expected a dict with ranks, objects and room_receptacles, found {type(content)}")
    if missing := [key for key in ("ranks", "objects", "room_receptacles") if key not in content]:
        raise VotesError(f"{path} has no {missing[0]!r}; it must hold ranks, objects and room_receptacles")
    return _checked(path, content)


def read_splits(path: Path, sha256: str | None = None) -> dict[str, tuple[str, ...]]:
    """Read the object types of ``train``, ``val`` and ``test`` from a YAML or JSON file with the key ``objects``.

    ``sha256`` is the expected hash of the names (`splits_hash`). Raises `VotesError`.
    """
    if not path.is_file():
        raise VotesError(f"no such file of splits: {path}")
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))["objects"]
        splits = {name: tuple(object_type(str(entry)) for entry in raw[name]) for name in SPLITS}
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise VotesError(
            f"{path} is not a file of splits ({error}); it must list object names under objects: {', '.join(SPLITS)}"
        ) from error
    names = [name for split in splits.values() for name in split]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise VotesError(f"{path}: the object {twice[0]!r} is listed twice; each belongs to one split")
    if sha256 is not None and (found := splits_hash(splits)) != sha256:
        raise VotesError(f"{path}: its names have the sha256 {found}, expected {sha256}: these are other splits")
    return splits


def splits_hash(splits: Mapping[str, Sequence[str]]) -> str:
    """Return the sha256 of the assignment of object types to splits."""
    return hashlib.sha256(json.dumps({name: sorted(splits[name]) for name in SPLITS}).encode()).hexdigest()


def split_objects(splits: Mapping[str, Sequence[str]], name: str) -> tuple[str, ...]:
    """Return the object types of one split.

    Raises:
        VotesError: the split does not exist or is empty.
    """
    if name not in splits:
        raise VotesError(f"unknown split {name!r} of the objects; allowed: {', '.join(splits)}")
    if not splits[name]:
        raise VotesError(f"the split {name!r} has no objects; give other splits, or the objects of another split")
    return tuple(splits[name])


def _checked(path: Path, content: Mapping[str, Any]) -> Votes:
    ranks, objects = content["ranks"], [str(name) for name in content["objects"]]
    pairs = [str(name).split("|") for name in content["room_receptacles"]]
    if not isinstance(ranks, np.ndarray) or ranks.dtype.kind != "i" or ranks.ndim != 3 or 0 in ranks.shape:
        raise VotesError(f"{path}: ranks must be whole numbers of three dimensions (place, object, person), none empty")
    if ranks.shape[:2] != (len(pairs), len(objects)):
        raise VotesError(
            f"{path}: ranks are of {ranks.shape[0]} places and {ranks.shape[1]} objects, "
            f"but {len(pairs)} places and {len(objects)} objects are named"
        )
    if wrong := [pair for pair in pairs if len(pair) != 2 or not all(part.strip() for part in pair)]:
        raise VotesError(f"{path}: a place must be named room|receptacle, got {'|'.join(wrong[0])!r}")
    types = [object_type(name) for name in objects]
    for name, kind in zip(objects, types, strict=True):
        if not kind.isidentifier():
            raise VotesError(
                f"{path}: {name!r} is not an object name; letters, digits and _ are allowed, a letter first"
            )
        if types.count(kind) > 1:
            raise VotesError(f"{path}: two objects are called {name!r}; give each a name of its own")
    without = np.flatnonzero((ranks <= 0).all(axis=(0, 2)))
    if len(without):
        raise VotesError(
            f"{path}: nobody knows a right place for the object {objects[without[0]]!r}; leave it out of the data"
        )
    return Votes(tuple((room, place) for room, place in pairs), tuple(types), ranks.astype(np.int16))


def _unpickle(path: Path) -> object:
    try:
        with path.open("rb") as file:
            version = npy.read_magic(file)
            header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            _, _, dtype = header(file)
            if dtype != np.dtype(object):
                raise ValueError(f"an array of {dtype} instead of one pickled dict")
            content = _ArraysOnly(io.BytesIO(file.read()), encoding="latin1").load()
    except pickle.UnpicklingError as error:
        raise VotesError(f"{path} is not read: {error}") from error
    except (OSError, ValueError, EOFError, KeyError, TypeError, IndexError, AttributeError, MemoryError) as error:
        raise VotesError(f"{path} is damaged or not a file of votes ({error})") from error
    return content.item() if isinstance(content, np.ndarray) and content.shape == () else content


# The functions with which numpy rebuilds a scalar and an array; their names depend on numpy's version.
_SCALAR, _RECONSTRUCT = np.float64(0).__reduce__()[0], np.zeros(0).__reduce__()[0]
_ALLOWED: Mapping[str, Any] = {
    "numpy.core.multiarray.scalar": _SCALAR,
    "numpy._core.multiarray.scalar": _SCALAR,
    "numpy.core.multiarray._reconstruct": _RECONSTRUCT,
    "numpy._core.multiarray._reconstruct": _RECONSTRUCT,
    "numpy.ndarray": np.ndarray,
    "numpy.dtype": np.dtype,
}
"""The names that a pickle of arrays, strings and lists needs, by the module names of numpy 1 and 2."""


class _ArraysOnly(pickle.Unpickler):
    """Refuses every class and function except numpy's for arrays."""

    def find_class(self, module: str, name: str) -> Any:
        """Return the allowed class of that name."""
        if (full := f"{module}.{name}") not in _ALLOWED:
            raise pickle.UnpicklingError(f"its pickle asks for {full}; only numpy's arrays are allowed")
        return _ALLOWED[full]
