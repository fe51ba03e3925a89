import hashlib
import os
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from mrtask.homes import download
from mrtask.homes.download import PROCTHOR_10K, DownloadError, RemoteFile, fetch_procthor10k

BODY = os.urandom(300_000)


class Server(ThreadingHTTPServer):
    """Serves `BODY`; connections break after the bytes listed in ``cuts``; ``asked`` lists the Range headers."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.cuts, self.asked, self.ranges = [], [], True


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.asked.append(self.headers.get("Range"))
        if self.path != "/homes.jsonl.gz":
            self.send_error(404, "Not Found")
            return
        start = 0
        if self.server.ranges and (asked := self.headers.get("Range")):
            start = int(asked.removeprefix("bytes=").removesuffix("-"))
            self.send_response(206)
        else:
            self.send_response(200)
        self.send_header("Content-Length", str(len(BODY) - start))
        self.end_headers()
        end = start + self.server.cuts.pop(0) if self.server.cuts else len(BODY)
        self.wfile.write(BODY[start:end])
        self.close_connection = True

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def remote(server, path="homes.jsonl.gz", sha256=None):
    url = f"http://127.0.0.1:{server.server_port}/{path}"
    return {"homes.jsonl.gz": RemoteFile(url, len(BODY), sha256 or hashlib.sha256(BODY).hexdigest())}


def fetch(folder, files):
    return fetch_procthor10k(folder, ["homes.jsonl.gz"], files=files)["homes.jsonl.gz"]


def test_a_good_file_is_fetched_once_and_then_used_offline(server, tmp_path):
    folder = tmp_path / "new" / "procthor10k"
    path = fetch(folder, remote(server))
    assert path.read_bytes() == BODY
    assert list(folder.iterdir()) == [path]
    server.shutdown()
    assert fetch(folder, remote(server)) == path
    assert server.asked == [None]


def test_a_wrong_checksum_leaves_nothing(server, tmp_path):
    with pytest.raises(
        DownloadError, match=r"does not have the sha256 0000.*; it was deleted: try again, or a copy from"
    ):
        fetch(tmp_path, remote(server, sha256="0" * 64))
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_local_file_is_fetched_again(server, tmp_path):
    (tmp_path / "homes.jsonl.gz").write_bytes(BODY[:1000])
    assert fetch(tmp_path, remote(server)).read_bytes() == BODY


def test_a_cut_connection_is_taken_up_where_it_broke(server, tmp_path):
    server.cuts = [100_000, 50_000]
    assert fetch(tmp_path, remote(server)).read_bytes() == BODY
    assert server.asked[0] is None
    starts = [int(asked.removeprefix("bytes=").removesuffix("-")) for asked in server.asked[1:]]
    assert len(starts) == 2
    assert 0 < starts[0] <= 100_000 <= starts[1] + download.CHUNK_BYTES
    assert starts[1] <= 150_000


def test_after_too_many_cuts_the_part_is_kept_for_the_next_run(server, tmp_path):
    server.cuts = [70_000] * download.TRIES
    with pytest.raises(DownloadError, match="was cut; the same command continues from there"):
        fetch(tmp_path, remote(server))
    assert [path.name for path in tmp_path.iterdir()] == ["homes.jsonl.gz.part"]
    assert fetch(tmp_path, remote(server)).read_bytes() == BODY
    assert server.asked[-1] is not None


def test_a_server_that_knows_no_ranges_starts_over(server, tmp_path):
    server.ranges = False
    server.cuts = [100_000]
    assert fetch(tmp_path, remote(server)).read_bytes() == BODY


def test_not_found(server, tmp_path):
    with pytest.raises(DownloadError, match=r"homes\.jsonl\.gz: http://.*/other answered 404 Not Found; a copy from"):
        fetch(tmp_path, remote(server, "other"))
    assert list(tmp_path.iterdir()) == []


def test_offline(tmp_path):
    files = {"homes.jsonl.gz": RemoteFile("http://127.0.0.1:9/homes.jsonl.gz", 1, "0" * 64)}
    with pytest.raises(
        DownloadError, match=r"cannot be reached \(are you offline\?\); a copy from elsewhere can be put at"
    ):
        fetch(tmp_path, files)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_disk_without_room(server, tmp_path):
    (tmp_path / "homes.jsonl.gz.part").symlink_to("/dev/full")
    with pytest.raises(DownloadError, match=r"cannot be written to .* \(No space left on device\); 300000 bytes are"):
        fetch(tmp_path, remote(server))
    assert not (tmp_path / "homes.jsonl.gz").exists()


def test_unknown_names(tmp_path):
    with pytest.raises(ValueError, match=r"no file 'tset' in ProcTHOR-10K; allowed: train\.jsonl\.gz, val"):
        fetch_procthor10k(tmp_path, ["tset"])


def test_the_asset_database_is_the_published_one(shared_homes):
    database = (shared_homes / "asset-database.json").read_bytes()
    expected = PROCTHOR_10K["asset-database.json"]
    assert (len(database), hashlib.sha256(database).hexdigest()) == (expected.size_bytes, expected.sha256)
