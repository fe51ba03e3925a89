"""The nodes of the Ray cluster that a run uses: how many slots they have, who comes, goes, or is left out, and why.

`Nodes` is asked about once a second by the loop that hands out work. It says a line whenever something changes.
"""

import math
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import lazy_loader

from mrtask.names import counted
from pipeline.base import console
from pipeline.base.config import UserError
from pipeline.base.sections import Cluster

if TYPE_CHECKING:
    import ray
else:
    ray = lazy_loader.load("ray")  # takes a second to import, and a run that has nothing to do needs no workers

RECOUNT_S = 2.0
"""How often nodes are counted."""
HEAD_SILENT_S = 20.0
"""A head that nobody reached for this long is dead. (After 60 s, Ray would abort this process.)"""
HEAD_TIMEOUT_S = 2.0
WAIT_FOR_NODES_S = 600.0
"""How long a run waits for a first worker, which an autoscaler may have to start."""
NODE_ID = "ray.io/node-id"
"""The label that Ray gives each node."""


class HeadLost(UserError):
    """The head of the cluster does not answer any more."""


@dataclass(frozen=True)
class Node:
    """A node and how many items it could run at once."""

    id: str
    name: str
    slots: int


class Nodes:
    """The nodes that a run may use; the first count says nothing, later ones say what changed."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._head = _head_of(cluster.address)
        self._there: dict[str, Node] = {}
        self._left_out: dict[str, str] = {}
        self._deaths: list[str] = []
        self._counted_s = -math.inf
        self._heard_s = self._had_slots_s = time.monotonic()
        self._silent = self._waiting = False
        self._counting = threading.Lock()
        self._count()

    @property
    def slots(self) -> int:
        """How many items run at once, by cores and memory."""
        return sum(node.slots for node in self._used())

    @property
    def free_cores(self) -> int:
        """How many cores nobody uses at the moment, those of nodes that are left out too."""
        return int(ray.available_resources().get("CPU", 0))  # type: ignore[no-untyped-call]

    @property
    def selector(self) -> Mapping[str, str]:
        """Ray's label selector for the nodes that are not left out; empty where none is."""
        return {NODE_ID: f"!in({','.join(sorted(self._left_out))})"} if self._left_out else {}

    def head_answers(self) -> bool:
        """Tell whether the head answers; while it does not, Ray's calls may hang.

        Raises:
            HeadLost: it has not for `HEAD_SILENT_S`.
        """
        try:
            socket.create_connection(self._head, HEAD_TIMEOUT_S).close()
        except OSError as error:
            silent_s = time.monotonic() - self._heard_s
            where = f"the head of the Ray cluster at {self._head[0]}:{self._head[1]}"
            if silent_s >= HEAD_SILENT_S:
                raise HeadLost(
                    f"{where} has not answered for {console.duration(silent_s)} ({error}). Start the cluster again, "
                    "then the same command continues"
                ) from error
            if not self._silent:
                console.line(f"{where} does not answer; the run waits for it")
            self._silent = True
            return False
        if self._silent:
            console.line("it answers again")
        self._silent, self._heard_s = False, time.monotonic()
        return True

    def recount(self) -> bool:
        """Count the nodes when it is time, and say what changed; tell whether the head answers.

        Raises:
            HeadLost: the head has not answered for `HEAD_SILENT_S`.
            UserError: no node can be used.
        """
        with self._counting:  # cells of a sweep may run in several threads
            return self._recount()

    def _recount(self) -> bool:
        if time.monotonic() - self._counted_s < RECOUNT_S:
            return not self._silent
        if not self.head_answers():
            return False
        before = self._there
        self._count()
        for lost in before.keys() - self._there.keys():
            self._left_out.pop(lost, None)
            console.line(f"{before[lost].name} is lost; what it ran goes to others. {self._size}")
        for joined in self._there.keys() - before.keys():
            console.line(f"{self._there[joined].name} joined. {self._size}")
        if self._deaths:
            died = counted(len(self._deaths), "worker")
            console.line(f"{died} died, and what they ran goes to others; the last one: {self._deaths[-1]}")
            self._deaths.clear()
        return True

    def note_death(self, error: Exception) -> None:
        """Note that a worker died."""
        self._deaths.append(" ".join(str(error).split(". ")[0].split())[:200])

    def leave_out(self, node_id: str, hostname: str, differences: Sequence[str]) -> None:
        """Give a node nothing more to run, because its code is not this process's.

        Raises:
            UserError: no other node is left.
        """
        if node_id in self._left_out:
            return
        name = self._there[node_id].name if node_id in self._there else f"node {hostname}"
        self._left_out[node_id] = f"{name}: {', '.join(differences)}"
        console.line(f"left out, because its rows would not be this code's: {self._left_out[node_id]}")
        self._check_some_left()

    @property
    def _size(self) -> str:
        return f"{counted(len(self._used()), 'node')}, {counted(self.slots, 'worker')} now"

    def _used(self) -> list[Node]:
        return [node for node in self._there.values() if node.id not in self._left_out]

    def _count(self) -> None:
        need_bytes = self._cluster.memory_per_task_gb * 2**30
        alive = [node for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
        self._counted_s = time.monotonic()
        resources = [node["Resources"] for node in alive]
        slots = [min(int(one.get("CPU", 0)), int(one.get("memory", 0) / need_bytes)) for one in resources]
        self._there = {
            node["NodeID"]: Node(node["NodeID"], _name(node), count)
            for node, count in zip(alive, slots, strict=True)
            if count
        }
        if self.slots:
            self._had_slots_s, self._waiting = time.monotonic(), False
        elif any(one.get("CPU", 0) >= 1 and one.get("memory", 0) < need_bytes for one in resources):
            most_gb = max(one.get("memory", 0) for one in resources) / 2**30
            raise UserError(
                f"cluster.memory_per_task_gb={self._cluster.memory_per_task_gb:g}: no node has that much; "
                f"at most {most_gb:.1f}"
            )
        else:
            self._check_some_left()
            self._wait_for_nodes()

    def _wait_for_nodes(self) -> None:
        waited_s = time.monotonic() - self._had_slots_s
        if waited_s >= WAIT_FOR_NODES_S:
            raise UserError(
                f"cluster.address={self._cluster.address}: no node with a core has joined for "
                f"{console.duration(waited_s)}; start nodes, then run the same command again"
            )
        if not self._waiting:
            console.line(f"no node has a core; waiting up to {console.duration(WAIT_FOR_NODES_S)} for one to join")
        self._waiting = True

    def _check_some_left(self) -> None:
        if self._there and not self._used():
            listed = "\n".join(f"  {text}" for text in self._left_out.values())
            raise UserError(
                f"no node runs the code of this process:\n{listed}\nInstall the same versions on all nodes, and start "
                "Ray there anew; where files changed while the run was under way, run the same command again"
            )


def _name(node: Mapping[str, Any]) -> str:
    return f"node {node['NodeManagerHostname']} ({node['NodeManagerAddress']}, {node['NodeID'][:8]})"


def _head_of(address: str) -> tuple[str, int]:
    """Return host and port where the head answers: of a client its server, else Ray's own store."""
    if not address.startswith("ray://"):
        address = str(ray.get_runtime_context().gcs_address)
    return host_and_port(address)


def host_and_port(address: str) -> tuple[str, int]:
    """Return both parts of ``[ray://]host:port``; raises ValueError where the port is no number."""
    host, _, port = address.removeprefix("ray://").partition("/")[0].rpartition(":")
    return host.strip("[]"), int(port)
