"""The pool against dying, failing and hanging tasks."""

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.backends import pool as pool_module
from pipeline.backends.pool import ItemError, Outcome, Pool
from pipeline.base.config import UserError
from pipeline.base.sections import Cluster
from pipeline.store import version
from tests.pipeline import pool_tasks as tasks
from tests.pipeline.harness import ROOT

LOCAL = Cluster(address="local", cpus=2, memory_per_task_gb=0.5, retries=2)


@pytest.fixture
def pool(ray_session: None) -> Iterator[Pool]:
    with Pool(LOCAL) as opened:
        yield opened


def outcomes(run: Iterator[Outcome[Any, Any] | None]) -> dict[Any, Outcome[Any, Any]]:
    found: dict[Any, Outcome[Any, Any]] = {}
    for outcome in run:
        if outcome is not None:
            assert outcome.item not in found
            found[outcome.item] = outcome
    return found


def test_every_item_comes_back_once(pool: Pool) -> None:
    found = outcomes(pool.run(tasks.square, range(40)))
    assert {item: outcome.value for item, outcome in found.items()} == {item: item * item for item in range(40)}
    assert {outcome.attempt for outcome in found.values()} == {1}


def test_values_come_with_their_items_and_one_that_fails_is_named(pool: Pool, tmp_path: Path) -> None:
    assert dict(pool.values(tasks.square, range(40), unit="squares")) == {item: item * item for item in range(40)}
    with pytest.raises(ItemError, match=r"(?s)squares: number 1 failed: .*item 1 is not to my liking"):
        list(pool.values(tasks.fail_until, [1], tmp_path, 9, unit="squares", named=lambda item: f"number {item}"))


def test_items_are_taken_only_as_workers_need_them(pool: Pool) -> None:
    taken = []
    items = (taken.append(item) or item for item in range(1000))  # type: ignore[func-returns-value]
    run = pool.run(tasks.square, items)
    next(run)
    run.close()  # type: ignore[attr-defined]
    assert len(taken) <= 2 * LOCAL.cpus * pool_module.IN_FLIGHT_PER_SLOT


def test_an_exception_is_tried_once_more_and_then_reported(pool: Pool, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    once = outcomes(pool.run(tasks.fail_until, range(3), tmp_path / "a", 1))
    assert [(once[item].value, once[item].attempt) for item in range(3)] == [(0, 2), (1, 2), (2, 2)]
    (tmp_path / "b").mkdir()
    always = outcomes(pool.run(tasks.fail_until, range(3), tmp_path / "b", 9))
    for item, outcome in always.items():
        assert outcome.attempt == 2
        assert outcome.failure is not None and outcome.failure.kind == "error"
        assert f"item {item} is not to my liking" in outcome.failure.message
        assert "fail_until" in outcome.failure.message


def test_a_killed_worker_costs_no_item(pool: Pool, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    found = outcomes(pool.run(tasks.die_until, range(4), tmp_path / "a", 1))
    assert {item: outcome.value for item, outcome in found.items()} == {item: item for item in range(4)}
    assert all(found[item].attempt >= 2 for item in (1, 3))


def test_a_task_that_kills_every_worker_is_given_up(pool: Pool, tmp_path: Path) -> None:
    found = outcomes(pool.run(tasks.die_until, [1], tmp_path, 99))
    failure = found[1].failure
    assert failure is not None and failure.kind == "crash"
    assert f"died {LOCAL.retries + 1} times" in failure.message


def test_a_task_over_its_time_is_stopped(pool: Pool) -> None:
    found = outcomes(pool.run(tasks.sleep, [60.0, 0.0], timeout_s=1.0))
    assert found[0.0].value == 0.0
    failure = found[60.0].failure
    assert failure is not None and (failure.kind, failure.message) == ("timeout", "stopped after 1 s")
    assert found[60.0].attempt == 1


def test_a_task_deaf_to_its_time_limit_has_its_worker_killed(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "HARD_LIMIT_GRACE_S", 1.0)
    found = outcomes(pool.run(tasks.sleep_deaf, [60.0], timeout_s=1.0))
    failure = found[60.0].failure
    assert failure is not None and failure.kind == "timeout"


def test_in_a_batch_of_short_items_each_answers_for_itself(pool: Pool, tmp_path: Path) -> None:
    found = outcomes(pool.run(tasks.worst_of_many, range(60), tmp_path, timeout_s=2.0))
    failures = {item: outcome.failure for item, outcome in found.items() if outcome.failure is not None}
    assert list(failures) == [32] and failures[32].kind == "timeout"
    assert {item: outcome.value for item, outcome in found.items() if item != 32} == {
        item: item for item in range(60) if item != 32
    }
    tried_again = {item for item, outcome in found.items() if outcome.attempt > 1}
    assert tried_again > {30, 31}, "they were in no batch with others"
    assert len(tried_again) < 60, "all were tried again"


def test_a_run_takes_no_more_cores_of_a_cluster_than_it_may(ray_session: None) -> None:
    with Pool(LOCAL.model_copy(update={"cpus": 1})) as opened:
        spans = sorted(one.value for one in outcomes(opened.run(tasks.span, range(4), 0.3)).values() if one.value)
    assert len(spans) == 4
    assert all(ended_s <= began_s for (_, ended_s), (began_s, _) in itertools.pairwise(spans))


def test_shared_values_are_unpacked_once_per_worker(pool: Pool) -> None:
    found = outcomes(pool.run(tasks.identity_of_shared, range(30), np.zeros(10_000)))
    places = {outcome.value for outcome in found.values()}
    assert len(places) == len({process for process, _ in places})


def test_heartbeats_come_while_nothing_finishes(pool: Pool) -> None:
    beats = [outcome for outcome in pool.run(tasks.sleep, [2.5]) if outcome is None]
    assert len(beats) >= 1


def test_results_are_the_same_on_one_and_two_workers(ray_session: None) -> None:
    values = []
    for cpus in (1, 2):
        with Pool(LOCAL.model_copy(update={"cpus": cpus})) as opened:
            assert opened.slots == cpus
            found = outcomes(opened.run(tasks.house_rooms, range(6), 5))
            values.append({item: outcome.value for item, outcome in found.items()})
    assert values[0] == values[1]


def test_memory_that_no_node_has_is_refused(ray_session: None) -> None:
    with (
        Pool(LOCAL.model_copy(update={"memory_per_task_gb": 1e6})) as opened,
        pytest.raises(UserError, match=r"cluster.memory_per_task_gb=1e.06: no node has that much; at most"),
    ):
        _ = opened.slots


def test_workers_with_other_code_run_nothing(
    ray_session: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def other(modules: tuple[str, ...]) -> dict[str, str]:
        return {**version.worker_code(modules), "numba": "0.1", "mrtask.execution": "0" * 16}

    monkeypatch.setattr(pool_module, "worker_code", other)
    with Pool(LOCAL) as opened, pytest.raises(UserError, match=r"(?s)no node runs the code of this process:.*numba"):
        list(opened.run(tasks.die_until, [1], tmp_path, 99))
    assert not list(tmp_path.iterdir()), "it was run"
    assert "left out, because its rows would not be this code's" in capsys.readouterr().out


def test_an_older_build_cannot_answer_by_its_own_comparison(
    ray_session: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(pool_module, "COMPARING", "json")  # any module that has no such function
    with Pool(LOCAL) as opened, pytest.raises(UserError, match="another version of mrtask, or none"):
        list(opened.run(tasks.die_until, [1], tmp_path, 99))
    assert not list(tmp_path.iterdir()), "it was run"


LISTENERS = """
import json, os, psutil
from pipeline.backends.pool import Pool
from pipeline.base.sections import Cluster
from tests.pipeline import pool_tasks as tasks
with Pool(Cluster(address="local", cpus=1, memory_per_task_gb=0.5, retries=2)) as pool:
    list(pool.run(tasks.square, range(2)))
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    found = [(one.name(), at) for one in processes for at in one.net_connections("tcp")]
    found = [(name, at.laddr.ip) for name, at in found if at.status == "LISTEN"]
    print(json.dumps([found, os.environ["RAY_AUTH_MODE"], os.environ["RAY_AUTH_TOKEN"]]))
"""
"""A process of its own: Ray reads where to listen when it is imported, and a test before may have imported it."""


def test_ray_on_this_machine_listens_on_the_loopback_alone_and_asks_for_a_token() -> None:
    done = subprocess.run([sys.executable, "-c", LISTENERS], cwd=ROOT, capture_output=True, text=True, check=True)
    listening, mode, token = json.loads(done.stdout.splitlines()[-1])
    assert {"gcs_server", "raylet"} <= {name for name, _ in listening}
    assert {ip for _, ip in listening} <= {"127.0.0.1", "::ffff:127.0.0.1"}, listening
    assert mode == "token" and token


def test_a_token_is_its_owners_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    token = tmp_path / "auth_token"
    token.write_text("secret")
    token.chmod(0o644)
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(token))
    pool_module._keep_token_private()
    assert token.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("address", ["ray://127.0.0.1:1", "127.0.0.1:1"])
def test_an_address_where_nobody_answers_is_refused_at_once(address: str) -> None:
    began_s = time.monotonic()
    with pytest.raises(UserError, match=f"cluster.address={address}: nobody answers there"):
        pool_module._start(LOCAL.model_copy(update={"address": address}))
    assert time.monotonic() - began_s < 10


@pytest.mark.parametrize(
    "problem",
    [
        ConnectionError("no cluster found"),
        RuntimeError("Version mismatch: 2.60.0, 2.9"),
        Exception("The current node timed out during startup"),
    ],
)
def test_what_ray_says_against_a_cluster_is_passed_on(problem: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**options: Any) -> None:
        raise problem

    monkeypatch.setattr(pool_module.ray, "init", refuse)
    with pytest.raises(UserError, match=f"cluster.address=auto: Ray cannot be used there: {problem}"):
        pool_module._start(LOCAL.model_copy(update={"address": "auto"}))
