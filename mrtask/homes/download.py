"""Download public data once and check its sha256; afterwards, everything works offline.

Files appear complete or not at all. The part that an interrupted download has received stays beside the file
(``.part``), and the next attempt continues from there if the server allows it. Sources: ProcTHOR-10K from
github.com/allenai/procthor-10k; for the sizes of furniture, the asset database of github.com/allenai/procthor (both
Apache-2.0); for where people put things, github.com/yashkant/housekeep (MIT).
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pooch
import requests
from tqdm import tqdm

from mrtask.errors import InputError

HOMES_URL = "https://media.githubusercontent.com/media/allenai/procthor-10k/439193522244720b86d8c81cde2e51e3a4d150cf/"
ASSETS_URL = (
    "https://raw.githubusercontent.com/allenai/procthor/d4c4c6a9fdd9679c8b9343d771c510016cd310df/procthor/databases/"
)
VOTES_URL = "https://raw.githubusercontent.com/yashkant/housekeep/ff57c791/cos_eor/scripts/orm/amt_data/"
TRIES = 3
TIMEOUT_S = 30
CHUNK_BYTES = 1 << 14


@dataclass(frozen=True)
class RemoteFile:
    """A file's address and expected content. Without a ``sha256``, the file's reader checks the content."""

    url: str
    size_bytes: int
    sha256: str | None


PROCTHOR_10K: Mapping[str, RemoteFile] = {
    "train.jsonl.gz": RemoteFile(
        HOMES_URL + "train.jsonl.gz", 53314510, "ee3c4aa14b4d8f0895fecfb5fdaca59395427ca1018b2f9aeeedbc61e5824587"
    ),
    "val.jsonl.gz": RemoteFile(
        HOMES_URL + "val.jsonl.gz", 5094681, "d808540514e26b6726cd2790490e669b572eeb94febb5188a2f403591dd21721"
    ),
    "test.jsonl.gz": RemoteFile(
        HOMES_URL + "test.jsonl.gz", 5022093, "9a9fa6f134e76fe87f3fd92c00883651cf9fadf4e9ad4072d6d73be229f001dc"
    ),
    "asset-database.json": RemoteFile(
        ASSETS_URL + "asset-database.json", 1497002, "a292c54a227e16b27db81e6bc105c863e674cd6c1ec892d231886ea7604395d4"
    ),
}

VOTES_FILE, SPLITS_FILE = "data.npy", "splits.yaml"
HOUSEKEEP: Mapping[str, RemoteFile] = {
    VOTES_FILE: RemoteFile(
        VOTES_URL + VOTES_FILE, 2788628, "40d083e88eaf4d2eee644c35525c48c44668626f409dd7e76bf99f64aba8f2ca"
    ),
    SPLITS_FILE: RemoteFile(VOTES_URL + SPLITS_FILE, 5000, None),
}


class DownloadError(InputError):
    """A file that could not be downloaded. The message names the file, the reason, and what to do."""


def fetch_procthor10k(
    folder: Path,
    names: Iterable[str] = tuple(PROCTHOR_10K),
    progress: bool = False,
    files: Mapping[str, RemoteFile] = PROCTHOR_10K,
) -> dict[str, Path]:
    """Return the path of each named file in ``folder``, and download those that are not there yet.

    A file with the right checksum is not downloaded again. Raises `DownloadError` (offline, not found, wrong checksum,
    no space on the disk) and `ValueError` for unknown names.
    """
    wanted = list(names)
    if unknown := sorted(set(wanted) - set(files)):
        raise ValueError(f"no file '{unknown[0]}' in ProcTHOR-10K; allowed: {', '.join(files)}")
    return {name: fetch(files[name], folder / name, progress) for name in wanted}


def fetch(remote: RemoteFile, path: Path, progress: bool = False) -> Path:
    """Return ``path``, and download it if it is not there yet.

    A file with the right checksum, or any file if no checksum is given, is not downloaded again. Raises `DownloadError`
    (offline, not found, wrong checksum, no space on the disk).
    """
    part = path.with_name(path.name + ".part")

    def download(url: str, output: Any, _: object) -> None:
        _continue(url, part, progress)
        os.replace(part, output)

    pooch.get_logger().setLevel("WARNING")  # the progress bar shows what happens
    try:
        expected = f"sha256:{remote.sha256}" if remote.sha256 else None
        pooch.retrieve(remote.url, expected, path.name, path.parent, downloader=download)
    except requests.exceptions.RequestException as error:
        raise DownloadError(f"{path.name}: {_reason(error, remote)}; {_advice(path)}") from error
    except ValueError as error:
        problem = f"the file from {remote.url} does not have the sha256 {remote.sha256}"
        raise DownloadError(f"{path.name}: {problem}; it was deleted: try again, or {_advice(path)}") from error
    except OSError as error:
        problem = f"cannot be written to {path.parent} ({error.strerror or error})"
        raise DownloadError(f"{path.name}: {problem}; {remote.size_bytes} bytes are needed") from error
    return path


def _continue(url: str, part: Path, progress: bool) -> None:
    """Bring ``part`` to its full length.

    After a broken connection, a few more attempts continue where it ended.
    """
    for left in reversed(range(TRIES)):
        try:
            _request(url, part, progress)
            return
        except (requests.exceptions.ConnectionError, requests.exceptions.ChunkedEncodingError):
            if left == 0 or not part.exists():
                raise


def _request(url: str, part: Path, progress: bool) -> None:
    have = part.stat().st_size if part.exists() else 0
    headers = {"Range": f"bytes={have}-", "Accept-Encoding": "identity"} if have else {"Accept-Encoding": "identity"}
    with requests.get(url, headers=headers, stream=True, timeout=TIMEOUT_S) as response:
        if have and response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            return  # the file is complete; its checksum decides
        response.raise_for_status()
        goes_on = response.status_code == HTTPStatus.PARTIAL_CONTENT
        total = int(response.headers.get("Content-Length", 0)) + (have if goes_on else 0)
        with (
            part.open("ab" if goes_on else "wb") as file,
            tqdm(
                total=total or None,
                initial=have if goes_on else 0,
                unit="B",
                unit_scale=True,
                desc=part.stem,
                disable=not progress,
            ) as bar,
        ):
            for chunk in response.iter_content(CHUNK_BYTES):
                file.write(chunk)
                bar.update(len(chunk))


def _reason(error: requests.exceptions.RequestException, remote: RemoteFile) -> str:
    if error.response is not None:
        return f"{remote.url} answered {error.response.status_code} {error.response.reason}"
    if isinstance(error, requests.exceptions.ChunkedEncodingError):
        return f"the connection to {remote.url} was cut; the same command continues from there"
    return f"{remote.url} cannot be reached (are you offline?)"


def _advice(path: Path) -> str:
    return f"a copy from elsewhere can be put at {path}"
