"""A live team on a WebSocket of this process, so that tests need not wait for one to start."""

import asyncio
import threading
from contextlib import contextmanager

from mrtask.live.session import LiveSession
from pipeline.live.process import SessionHub
from pipeline.live.websocket import serve

ENDS_WITHIN_S = 60.0


@contextmanager
def live_process(live):
    """The live team on a WebSocket of this process; gives the port."""
    session, loop, ready = LiveSession(live), asyncio.new_event_loop(), threading.Event()
    ports, done = [], asyncio.Event()
    session.begin()

    async def run():
        async with serve(SessionHub(session), "127.0.0.1", 0, None) as port:
            ports.append(port)
            ready.set()
            await done.wait()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),))
    thread.start()
    assert ready.wait(ENDS_WITHIN_S)
    yield ports[0]
    loop.call_soon_threadsafe(done.set)
    thread.join(ENDS_WITHIN_S)
    loop.close()
