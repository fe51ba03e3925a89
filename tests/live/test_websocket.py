"""The WebSocket with listeners that misbehave: who sends too much or reads too little is let go, alone."""

import asyncio
import json

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from mrtask.live.session import MAX_BYTES, LiveSession
from pipeline.live.client import SocketClient
from pipeline.live.process import SessionHub
from tests.live.serving import ENDS_WITHIN_S, live_process
from tests.live.test_team import target_of, two_robots


@pytest.fixture
def live(two_room_home, two_room_map):
    return two_robots(two_room_home, two_room_map)


def arrives(live, name):
    event = {"type": "arrived", "id": name, "time_s": 1.0, "robot": name, "container": target_of(live, name)}
    return json.dumps(event)


def test_too_much_or_too_deep_is_refused_on_an_open_connection(live):
    with live_process(live) as port:
        friend = SocketClient(f"ws://127.0.0.1:{port}")
        with connect(f"ws://127.0.0.1:{port}", max_size=None) as connection:
            connection.send('{"type": "hello"}')
            welcome, *_, task = [json.loads(connection.recv(timeout=ENDS_WITHIN_S)) for _ in range(4)]
            assert (welcome["type"], task["type"]) == ("welcome", "task")
            connection.send('{"type": "batch", "events": ' + "[" * 50 + "]" * 50 + "}")
            answer = json.loads(connection.recv(timeout=ENDS_WITHIN_S))
            assert answer["status"] == "rejected" and "nested at most" in answer["reason"]
            connection.send("[" * (MAX_BYTES + 1))
            with pytest.raises(ConnectionClosed, match="1009"):
                connection.recv(timeout=ENDS_WITHIN_S)
        sent = friend.send("arrived", robot="r1", container=target_of(live, "r1"))
        while sent in friend.unanswered:
            assert friend.messages.get(timeout=ENDS_WITHIN_S) is not None
        friend.close()
    assert live.last_event == sent, "the others go on"


def test_ids_belong_to_the_client_that_gave_its_name(live):
    event = {"type": "pose", "id": "1", "time_s": 1.0, "robot": "r1", "x_m": 1.5, "y_m": 1.5}

    def said(port, client):
        with connect(f"ws://127.0.0.1:{port}") as connection:
            connection.send(json.dumps({"type": "hello", "client": client}))
            connection.send(json.dumps(event))
            while (message := json.loads(connection.recv(timeout=ENDS_WITHIN_S)))["type"] != "answer":
                pass
            return message["status"]

    with live_process(live) as port:
        assert [said(port, name) for name in ("a", "b", "a")] == ["accepted", "accepted", "duplicate"]


def test_who_does_not_read_is_let_go_and_the_sender_is_not(live):
    session = LiveSession(live)
    session.begin()

    async def play():
        hub = SessionHub(session)
        slow, quick = asyncio.Queue(1), asyncio.Queue()
        hub.listeners |= {"slow": slow, "quick": quick}
        await hub.receive("quick", arrives(live, "r1"))
        assert list(hub.listeners) == ["quick"]
        assert [slow.get_nowait(), slow.empty()] == [None, True], "the end of it"
        kinds = [json.loads(quick.get_nowait())["type"] for _ in range(quick.qsize())]
        assert kinds == ["answer", "order", "task"]
        await hub.receive("gone", arrives(live, "r2"))
        assert quick.qsize() == 2, "the news of one who has left still reach the others"

    asyncio.run(play())
