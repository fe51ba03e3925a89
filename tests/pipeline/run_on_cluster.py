"""Runs an evaluation on simulated one-core nodes: one runs other code, one is lost, one joins; see `test_cluster`."""

import json
import os
import sys
import threading
import time
from pathlib import Path

import pandas as pd
import ray
from ray.cluster_utils import Cluster

from pipeline.backends.nodes import RECOUNT_S
from tests.pipeline.harness import run_stage
from tests.pipeline.own_planners import Gate

NOTICED_WITHIN_S = 60
CHECKED_EVERY_MS = 500
"""How often a head asks its nodes whether they are there, so that it soon misses one. (Ray's default is 3 s.)"""


def main(workspace: Path, gate: Gate, other_code: Path, *overrides: str) -> None:
    """Prints as JSON how many nodes there were before and after, and how many rows when one was lost."""
    os.chdir(workspace)
    gate.shut_after(6)
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": {"health_check_period_ms": CHECKED_EVERY_MS}}
    # Ray's own end at exit needs signal handlers, which only the main thread can set; a node joins from another one.
    cluster = Cluster(initialize_head=True, head_node_args=head, shutdown_at_exit=False)
    doomed = cluster.add_node(num_cpus=1)
    path = os.pathsep.join([str(other_code), os.environ["PYTHONPATH"]])
    cluster.add_node(num_cpus=1, env_vars={"PYTHONPATH": path})
    cluster.wait_for_nodes()
    os.environ["RAY_ADDRESS"] = cluster.address
    target = workspace / "outputs" / "cluster" / "episodes"
    said = {}

    def lose_one_and_add_one() -> None:
        while not list(target.glob("part-*.parquet")):
            time.sleep(0.02)
        said["nodes_before"] = alive()
        cluster.remove_node(doomed, allow_graceful=False)
        said["rows_before"] = len(pd.read_parquet(target, columns=["trial_id"]))
        end_s = time.monotonic() + NOTICED_WITHIN_S
        while (after := alive()) == said["nodes_before"] and time.monotonic() < end_s:
            time.sleep(0.1)
        said["nodes_after"] = after
        time.sleep(2 * RECOUNT_S)
        cluster.add_node(num_cpus=1)
        time.sleep(2 * RECOUNT_S)
        gate.open()

    saboteur = threading.Thread(target=lose_one_and_add_one, daemon=True)
    saboteur.start()
    on_cluster = ("cluster.address=auto", "cluster.memory_per_task_gb=0.1", "output_dir=outputs/cluster")
    try:
        code = run_stage("evaluate", *overrides, *on_cluster)
        saboteur.join(NOTICED_WITHIN_S)
    finally:
        gate.open()
        ray.shutdown()
        cluster.shutdown()
    print(json.dumps(said))
    sys.exit(code)


def alive() -> int:
    """How many nodes are there."""
    return sum(node["Alive"] for node in ray.nodes())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Gate(Path(sys.argv[2])), Path(sys.argv[3]), *sys.argv[4:])
