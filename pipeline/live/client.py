"""A client of a live team, over pipes or a WebSocket; it imports nothing from this project, so you may copy it.

    client = PipeClient(["python", "-m", "pipeline.live", "map=lab.yaml", ...])      # or
    client = SocketClient("ws://127.0.0.1:8765", token=None)
    for order in client.orders():                     # {"robot": "r1", "action": "navigate", "route": [[x, y], ...]}
        drive(order)                                  # and, from wherever the robot reports:
        client.send("arrived", robot=order["robot"], container=order["container"])

Every event gets an id and a time. After a break `send_again` repeats what was not answered: it counts once.
"""

import json
import queue
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from subprocess import PIPE, Popen
from typing import Any

Message = dict[str, Any]


class Client:
    """Sends events, keeps answers, and yields orders one after the other; ``clock`` returns the time in seconds."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.time) -> None:
        self._write, self._clock, self._began_s = write, clock, clock()
        self.unanswered: dict[str, Message] = {}
        self.rejected: list[Message] = []
        self.task: Message = {}
        self.messages: queue.Queue[Message | None] = queue.Queue()

    def send(self, kind: str, **fields: Any) -> str:
        """Send an event; return its id."""
        event = {"type": kind, "id": uuid.uuid4().hex, "time_s": self._clock() - self._began_s, **fields}
        self.unanswered[event["id"]] = event
        self._write(json.dumps(event))
        return str(event["id"])

    def send_again(self) -> None:
        """Send everything again that was not answered, after a break."""
        for event in list(self.unanswered.values()):
            self._write(json.dumps(event))

    def orders(self, timeout_s: float | None = None) -> Iterator[Message]:
        """Yield the orders as they come, until the task is done or the connection ends."""
        while (message := self.messages.get(timeout=timeout_s)) is not None:
            if message["type"] == "order":
                yield message
            elif message["type"] == "task" and message["status"] == "done":
                return

    def take(self, line: str) -> None:
        """Handle a line from the live team."""
        message = json.loads(line)
        if message["type"] == "answer":
            self.unanswered.pop(message["event"], None)
            self.rejected += [message] * (message["status"] == "rejected")
        elif message["type"] == "task":
            self.task = message
            self._began_s = min(self._began_s, self._clock() - message["time_s"])
        self.messages.put(message)

    def _listen(self, lines: Iterator[Any], broken: type[Exception] = OSError) -> None:
        def run() -> None:
            with suppress(broken):
                for line in lines:
                    self.take(line)
            self.messages.put(None)

        threading.Thread(target=run, daemon=True).start()


class PipeClient(Client):
    """Starts the live team and talks to it over standard input and output."""

    def __init__(self, command: Sequence[str], cwd: Any = None, **options: Any) -> None:
        self.process = Popen(command, text=True, bufsize=1, cwd=cwd, stdin=PIPE, stdout=PIPE)
        super().__init__(lambda line: print(line, file=self.process.stdin, flush=True), **options)
        self._listen(iter(self.process.stdout or ()))


class SocketClient(Client):
    """Talks to a live team that listens on a WebSocket."""

    def __init__(self, address: str, token: str | None = None, **options: Any) -> None:
        from websockets.exceptions import ConnectionClosed
        from websockets.sync.client import connect

        self._open = ExitStack()
        self.connection = self._open.enter_context(connect(address))
        super().__init__(self.connection.send, **options)
        self.connection.send(json.dumps({"type": "hello", "token": token}))
        self._listen(iter(self.connection), ConnectionClosed)

    def close(self) -> None:
        """End the connection; the live team goes on."""
        self._open.close()
