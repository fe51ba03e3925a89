"""Live processes that start at once: they are forked from a server that has imported and warmed up `pipeline.live`.

Started as `python -m pipeline.live`, one takes seconds of imports, for the likelihood model and to load kernels, which
is more than most episodes take. A forked one is a process of its own too: it runs the same code from its command line's
arguments on and talks by its standard input and output, which are a socket here.
"""

import multiprocessing
import os
import socket
import sys
from collections.abc import Sequence
from typing import Any

from pipeline.live import process
from pipeline.live.client import Client

WARM = "simulators.pyrobosim.warm"
"""What the server imports before it forks."""
END_WITHIN_S = 60.0


class ServedClient(Client):
    """Starts a live process with these arguments and talks to it."""

    def __init__(self, arguments: Sequence[str], **options: Any) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([WARM])
        self._socket, theirs = socket.socketpair()
        with theirs:
            self.process = context.Process(target=_serve, args=(list(arguments), theirs), daemon=True)
            self.process.start()
        super().__init__(lambda line: self._socket.sendall(f"{line}\n".encode()), **options)
        self._lines = self._socket.makefile(encoding="utf-8")
        self._listen(iter(self._lines))

    def end(self) -> None:
        """End its input, which ends the process.

        Raises:
            RuntimeError: it goes on all the same, and was killed.
        """
        try:
            self._socket.shutdown(socket.SHUT_WR)
            self.process.join(END_WITHIN_S)
            if self.process.exitcode is None:
                raise RuntimeError(f"the live process did not end within {END_WITHIN_S:g} s of its input's end")
        finally:
            self.process.kill()
            self.process.join()
            self._lines.close()
            self._socket.close()


def _serve(arguments: Sequence[str], end: socket.socket) -> None:
    """Run the live process with this socket as its standard input and output."""
    for descriptor in (0, 1):
        os.dup2(end.fileno(), descriptor)
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    process.run(arguments)
