"""What is said of a cluster's nodes and its head; tests/pipeline/test_cluster.py has real ones."""

import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from pipeline.backends import nodes as module
from pipeline.backends.nodes import HeadLost, Nodes
from pipeline.base.config import UserError
from pipeline.base.sections import Cluster


class Lab:
    """A head that listens, and nodes that Ray says are there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.head = socket.create_server(("127.0.0.1", 0))
        self.nodes: list[dict[str, Any]] = []
        self.clock = 100.0
        self.port = self.head.getsockname()[1]
        monkeypatch.setattr(module.ray, "nodes", lambda: self.nodes)
        monkeypatch.setattr(module.time, "monotonic", lambda: self.clock)
        self.cluster = Cluster(address=f"ray://127.0.0.1:{self.port}", cpus=None, memory_per_task_gb=1, retries=0)

    def has(self, **cores: int) -> None:
        """Have these nodes, with as many cores and gigabytes."""
        self.nodes = [
            {
                "NodeID": name * 8, "Alive": True, "NodeManagerHostname": name, "NodeManagerAddress": "10.0.0.1",
                "Resources": {"CPU": count, "memory": count * 2.0**30},
            }
            for name, count in cores.items()
        ]  # fmt: skip

    def later(self, seconds: float) -> None:
        self.clock += seconds


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    lab = Lab(monkeypatch)
    yield lab
    lab.head.close()


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    return lambda: [line.strip() for line in capsys.readouterr().out.splitlines()]


def test_slots_follow_nodes_that_come_and_go(lab: Lab, said: Callable[[], list[str]]) -> None:
    lab.has(a=2)
    nodes = Nodes(lab.cluster)
    assert nodes.slots == 2 and said() == []
    lab.has(a=2, b=4)
    lab.later(module.RECOUNT_S)
    assert nodes.recount() and nodes.slots == 6
    assert said() == ["node b (10.0.0.1, bbbbbbbb) joined. 2 nodes, 6 workers now"]
    lab.has(b=4)
    lab.later(module.RECOUNT_S)
    assert nodes.recount() and nodes.slots == 4
    assert said() == ["node a (10.0.0.1, aaaaaaaa) is lost; what it ran goes to others. 1 node, 4 workers now"]


def test_a_node_with_other_code_is_left_out_and_named_and_without_others_it_is_an_error(
    lab: Lab, said: Callable[[], list[str]]
) -> None:
    lab.has(a=2, b=4)
    nodes = Nodes(lab.cluster)
    nodes.leave_out("b" * 8, "b", ["numba 0.67 instead of 0.68"])
    assert nodes.slots == 2 and nodes.selector == {"ray.io/node-id": "!in(bbbbbbbb)"}
    [line] = said()
    assert line.endswith("this code's: node b (10.0.0.1, bbbbbbbb): numba 0.67 instead of 0.68")
    nodes.leave_out("b" * 8, "b", ["numba 0.67 instead of 0.68"])
    assert said() == [], "it is said once"
    lab.has(b=4)
    lab.later(module.RECOUNT_S)
    with pytest.raises(UserError, match=r"(?s)no node runs the code of this process:\n  node b .*numba 0.67"):
        nodes.recount()


def test_deaths_of_workers_are_one_line(lab: Lab, said: Callable[[], list[str]]) -> None:
    lab.has(a=2)
    nodes = Nodes(lab.cluster)
    for reason in ("out of memory. And more", "killed. And more"):
        nodes.note_death(RuntimeError(reason))
    lab.later(module.RECOUNT_S)
    nodes.recount()
    assert said() == ["2 workers died, and what they ran goes to others; the last one: killed"]


def test_a_cluster_without_cores_is_waited_for_but_not_for_ever(lab: Lab, said: Callable[[], list[str]]) -> None:
    lab.has(head=0)
    nodes = Nodes(lab.cluster)
    assert said() == ["no node has a core; waiting up to 10 min 00 s for one to join"]
    lab.later(module.RECOUNT_S)
    nodes.recount()
    assert said() == []
    lab.later(module.WAIT_FOR_NODES_S)
    with pytest.raises(UserError, match="no node with a core has joined for 10 min"):
        nodes.recount()


def test_a_silent_head_is_waited_for_and_a_dead_one_named(lab: Lab, said: Callable[[], list[str]]) -> None:
    lab.has(a=2)
    nodes = Nodes(lab.cluster)
    lab.head.close()
    lab.later(module.RECOUNT_S)
    assert not nodes.recount()
    assert said() == [f"the head of the Ray cluster at 127.0.0.1:{lab.port} does not answer; the run waits for it"]
    lab.later(module.RECOUNT_S)
    assert not nodes.recount()
    lab.head = socket.create_server(("127.0.0.1", lab.port))
    lab.later(module.RECOUNT_S)
    assert nodes.recount() and said() == ["it answers again"]
    lab.head.close()
    lab.later(module.HEAD_SILENT_S)
    with pytest.raises(HeadLost, match=rf"the Ray cluster at 127.0.0.1:{lab.port} has not answered for 20 s"):
        nodes.recount()
