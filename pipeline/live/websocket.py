"""The live team's WebSocket: the same JSON messages, one per frame; listeners elsewhere must show the token first."""

import asyncio
import hmac
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Protocol

from websockets.asyncio.server import ServerConnection
from websockets.asyncio.server import serve as listen
from websockets.exceptions import ConnectionClosed

from mrtask.live.messages import Hello
from mrtask.live.session import MAX_BYTES, Unreadable, parse

HELLO_WITHIN_S = 10.0
REFUSED = 1008
"""WebSocket's close code for a broken rule."""
MAX_WAITING = 10_000
"""A listener that is this many messages behind is dropped."""


class Hub(Protocol):
    """Where messages go: ``listeners`` holds the queues to send from; None ends a queue."""

    listeners: dict[object, asyncio.Queue[str | None]]

    async def receive(self, sender: object, text: str | bytes, client: str = "") -> None:
        """Handle a message from a listener that gave this name, or none."""
        ...


@asynccontextmanager
async def serve(hub: Hub, host: str, port: int, token: str | None) -> AsyncIterator[int]:
    """Listen while the block runs; yields the port, which the system chooses for 0."""

    async def talk(connection: ServerConnection) -> None:
        if (hello := await _hello(connection, token)) is None:
            await connection.close(REFUSED, "the first message is hello, with the token where one is needed")
            return
        queue: asyncio.Queue[str | None] = asyncio.Queue(MAX_WAITING)
        hub.listeners[connection] = queue
        sending = asyncio.create_task(_send(connection, queue))
        try:
            await hub.receive(connection, Hello(type="hello").model_dump_json())
            async for text in connection:
                await hub.receive(connection, text, hello.client or "")
        except ConnectionClosed:
            pass  # hello gives it all orders again
        finally:
            hub.listeners.pop(connection, None)
            sending.cancel()

    # Browsers send an Origin: pages of other sites must not talk to a robot team on this machine.
    async with listen(talk, host, port, max_size=MAX_BYTES, origins=[None]) as server:
        yield next(iter(server.sockets)).getsockname()[1]


async def _hello(connection: ServerConnection, token: str | None) -> Hello | None:
    """Return the first message, if it is a hello with the token."""
    try:
        message = parse(await asyncio.wait_for(connection.recv(), HELLO_WITHIN_S))
    except (Unreadable, TimeoutError, ConnectionClosed):
        return None
    if not isinstance(message, Hello):
        return None
    shown = (message.token or "").encode()
    return message if token is None or hmac.compare_digest(shown, token.encode()) else None


async def _send(connection: ServerConnection, queue: "asyncio.Queue[str | None]") -> None:
    while (line := await queue.get()) is not None:
        await connection.send(line)
    await connection.close(REFUSED, "too far behind; come again and say hello")
