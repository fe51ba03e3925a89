"""The live process as a lab runs it: over pipes and WebSocket, with everything that goes wrong there."""

import json
import random
import subprocess
import sys
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from mrtask.live.saved import read_saved
from pipeline.live.client import Client, PipeClient, SocketClient
from pipeline.live.process import lines_of
from tests.pipeline.harness import ROOT
from tests.pipeline.test_own_map import CONTAINERS, write_lab
from tests.tasks.naive_ltl import is_good_prefix

CONTENTS = {"fridge": ["egg"], "sofa": ["pillow", "remote"], "desk": ["laptop"], "shelf": ["laptop"]}
TEAM = "{r1: [2.5, 1.0], r2: [2.5, 1.0], r3: [2.5, 1.0]}"
TASK = "laptop or wallet, then remote, then egg"
FORMULA = (
    "&",
    ("|", ("U", ("&", ("!", "remote"), ("!", "egg")), "laptop"), ("U", ("&", ("!", "remote"), ("!", "egg")), "wallet")),
    ("U", ("!", "egg"), "remote"),
    ("F", "egg"),
)
DURATION_S = {"search": 5.0, "interact": 5.0}
SPEED_M_PER_S = 0.5
ANSWER_WITHIN_S = 120.0


def command(folder: Path, *options: str) -> list[str]:
    given = ["map=lab.yaml", "containers=containers.yaml", f"task={TASK}", f"team={TEAM}", "state=run/state.json"]
    quick = ["likelihood=uniform", "decide_by=learned_myopic", "log=run/log.jsonl"]
    return [sys.executable, "-m", "pipeline.live", *given, *quick, *options]


class Fleet:
    """Robots that do as ordered in a clock of their own, and a line that repeats, delays and turns round events."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.time_s = 0.0
        self.due: dict[str, tuple[float, dict[str, Any]]] = {}
        self.dead: set[str] = set()
        self.held: list[dict[str, Any]] = []
        self.number = 0

    def obey(self, order: dict[str, Any]) -> None:
        if order["robot"] in self.dead:
            return
        took_s = DURATION_S.get(order["action"], order["length_m"] / SPEED_M_PER_S)
        self.due[order["robot"]] = (float("inf") if order["action"] == "wait" else self.time_s + took_s, order)

    def next_events(self) -> list[dict[str, Any]]:
        """What is sent next: mostly what happens next, sometimes twice, sometimes after the event behind it."""
        robot, (at_s, order) = min(self.due.items(), key=lambda item: item[1][0])
        if at_s == float("inf"):
            sent, self.held = self.held, []
            assert sent, "nobody does anything and nothing is on its way"
            return sent
        self.due[robot] = (float("inf"), order)
        self.time_s = at_s
        self.number += 1
        event = {"id": f"f{self.number}", "time_s": at_s, "robot": robot, "container": order["container"]}
        if order["action"] == "navigate":
            event |= {"type": "arrived"}
        elif order["action"] == "search":
            event |= {"type": "search_ended", "objects": CONTENTS.get(order["container"], [])}
        else:
            event |= {"type": "interaction_ended", "object": order["object"]}
        if self.rng.random() < 0.2:
            self.held.append(event)
            return []
        sent = [event, *self.held]
        self.held = []
        return [*sent, event] if self.rng.random() < 0.3 else sent


class Lab:
    """The process, its client and the fleet; it can be killed and started again."""

    def __init__(self, folder: Path, socket: bool) -> None:
        write_lab(folder, CONTAINERS)
        self.folder, self.socket, self.fleet = folder, socket, Fleet(3)
        self.answers: list[dict[str, Any]] = []
        self.start()

    def start(self) -> None:
        if not self.socket:
            self.client: Client = PipeClient(command(self.folder), cwd=self.folder)
            self.process = self.client.process  # type: ignore[attr-defined]
        else:
            self.process, port = listening(self.folder)
            self.client = SocketClient(f"ws://127.0.0.1:{port}")
        self.read_until_task()

    def read_until_task(self) -> None:
        """Takes in messages up to the task's state, which ends every reply that changes something."""
        while True:
            message = self.client.messages.get(timeout=ANSWER_WITHIN_S)
            assert message is not None, "the connection ended"
            if message["type"] == "order":
                self.fleet.obey(message)
            elif message["type"] == "answer":
                self.answers.append(message)
                if message["status"] != "accepted":
                    return
            elif message["type"] == "task":
                self.task = message
                return

    def send(self, event: dict[str, Any]) -> None:
        self.client._write(json.dumps(event))
        self.read_until_task()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()
        if isinstance(self.client, SocketClient):
            self.client.close()

    def play(self) -> None:
        step = 0
        while self.task["status"] != "done":
            step += 1
            assert step < 200
            for event in self.fleet.next_events():
                self.send(event)
            if step == 3:
                self.fleet.dead.add("r2")
                self.fleet.due.pop("r2", None)
                self.send({"type": "robot_lost", "id": "lost", "time_s": self.fleet.time_s, "robot": "r2"})
            if step == 5:
                self.kill()
                self.start()


def listening(folder: Path, *options: str) -> tuple[subprocess.Popen[str], int]:
    started = subprocess.Popen(
        command(folder, "websocket=0", *options),
        cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert started.stderr is not None
    for line in started.stderr:
        if line.startswith("listening on port"):
            return started, int(line.split()[-1])
    raise AssertionError("the process ended before it listened")


@pytest.mark.parametrize("socket", [False, True], ids=["pipes", "websocket"])
def test_a_task_is_done_whatever_breaks(tmp_path: Path, socket: bool) -> None:
    lab = Lab(tmp_path, socket)
    try:
        lab.play()
    finally:
        lab.kill()
    assert {answer["status"] for answer in lab.answers} >= {"accepted", "duplicate"}
    assert all(answer["reason"] for answer in lab.answers if answer["status"] != "accepted")
    word = lab.task["word"]
    assert is_good_prefix(FORMULA, tuple(letter["object"] for letter in word), ("laptop", "wallet", "remote", "egg"))
    assert all(letter["object"] in CONTENTS[letter["container"]] for letter in word)
    check_legs(read_saved((tmp_path / "run/state.json").read_text()).model_dump(mode="json"), lab.fleet.dead)


def check_legs(state: dict[str, Any], dead: set[str]) -> None:
    """Time and place go on without a gap, nobody is too fast, what is interacted with was found before, by anybody."""
    searched: dict[str, float] = {}
    for robot in state["robots"]:
        for leg in robot["legs"]:
            if leg["kind"] == "search":
                searched[leg["container"]] = min(leg["t1_s"], searched.get(leg["container"], float("inf")))
    for robot in state["robots"]:
        clock, place = 0.0, (2.525, 1.025)
        for leg in robot["legs"]:
            assert leg["t0_s"] == pytest.approx(clock) and leg["t1_s"] >= leg["t0_s"]
            assert dist(leg["path"][0], place) < 0.08
            length_m = sum(dist(*ends) for ends in pairwise(leg["path"]))
            assert length_m <= SPEED_M_PER_S * (leg["t1_s"] - leg["t0_s"]) + 1e-4
            if leg["kind"] == "interact":
                assert searched[leg["container"]] <= leg["t0_s"]
            clock, place = leg["t1_s"], leg["path"][-1]
        assert (robot["mode"] == "lost") == (robot["name"] in dead)


def test_the_socket_wants_its_token_and_listens_on_this_machine_alone(tmp_path: Path) -> None:
    write_lab(tmp_path, CONTAINERS)
    token = "0123456789abcdef"
    process, port = listening(tmp_path, f"token={token}")
    try:
        for first in ('{"type": "hello", "token": "wrong"}', '{"type": "hello"}', "[" * 1000, "x" * 300_000):
            with pytest.raises(ConnectionClosed), connect(f"ws://127.0.0.1:{port}") as connection:
                connection.send(first)
                connection.recv(timeout=ANSWER_WITHIN_S)
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(f"ws://127.0.0.1:{port}", origin=Origin("http://evil.example")),
        ):
            pass
        client = SocketClient(f"ws://127.0.0.1:{port}", token)
        assert (client.messages.get(timeout=ANSWER_WITHIN_S) or {})["type"] == "welcome"
        listeners = subprocess.run(["cat", "/proc/net/tcp"], capture_output=True, text=True).stdout
        addresses = {line.split()[1] for line in listeners.splitlines() if f":{port:04X} " in f"{line.split()[1]} "}
        assert {address.split(":")[0] for address in addresses} == {"0100007F"}
        client.close()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["task=laptop and egg or remote"], "(laptop and egg) or remote"),
        (["task=F laptop & F"], "position"),
        (["team={r1: [50, 50]}"], "the nearest such place is"),
        (["team={}"], "team"),
        (["decide_by=known"], "knows all contents"),
        (["speed_m_per=1"], "speed_m_per: no such key; did you mean speed_m_per_s?"),
        (["map=gone.yaml"], "no such file"),
        (["websocket=here"], "give a port or host:port"),
        (["websocket=0.0.0.0:0"], "give a token of at least 16 characters"),
    ],
)
def test_mistakes_are_told_at_once(
    tmp_path: Path, options: list[str], said: str, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline.app.tool import main
    from pipeline.live import process

    write_lab(tmp_path, CONTAINERS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", command(tmp_path, *options)[2:])
    with pytest.raises(SystemExit) as stop:
        main(process.run, process.__doc__ or "")
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


def test_lines_are_cut_where_they_are_too_long(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    path.write_bytes(b"a\n\n" + b"x" * 1_000_000 + b"\nb\nc")
    with path.open("rb") as file:
        lines = list(lines_of(file.fileno()))
    assert [line[:1] for line in lines] == [b"a", b"x", b"b", b"c"]


def test_the_client_is_short_and_needs_nothing_of_ours() -> None:
    text = (ROOT / "pipeline" / "live" / "client.py").read_text()
    assert len(text.splitlines()) <= 100
    assert "import mrtask" not in text and "from mrtask" not in text and "from pipeline" not in text
