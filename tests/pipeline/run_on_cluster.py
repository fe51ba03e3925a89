"""Runs an evaluation on three simulated one-core nodes and takes one away in the middle; see `test_cluster`."""

import json
import os
import sys
import threading
import time
from pathlib import Path

import pandas as pd
import ray
from ray.cluster_utils import Cluster

from tests.pipeline.harness import run_stage
from tests.pipeline.own_planners import Gate

NOTICED_WITHIN_S = 60
CHECKED_EVERY_MS = 500
"""How often a head asks its nodes whether they are there, so that it soon misses one. (Ray's default is 3 s.)"""


def main(workspace: Path, gate: Gate, *overrides: str) -> None:
    """Prints as JSON how many nodes there were before and after, and how many rows when one was lost."""
    os.chdir(workspace)
    gate.shut_after(6)
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": {"health_check_period_ms": CHECKED_EVERY_MS}}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    doomed, _ = (cluster.add_node(num_cpus=1) for _ in range(2))
    cluster.wait_for_nodes()
    os.environ["RAY_ADDRESS"] = cluster.address
    target = workspace / "outputs" / "cluster" / "episodes"
    said = {}

    def lose_a_node() -> None:
        while not list(target.glob("part-*.parquet")):
            time.sleep(0.02)
        said["nodes_before"] = sum(node["Alive"] for node in ray.nodes())
        cluster.remove_node(doomed, allow_graceful=False)
        said["rows_before"] = len(pd.read_parquet(target, columns=["trial_id"]))
        gate.open()

    saboteur = threading.Thread(target=lose_a_node, daemon=True)
    saboteur.start()
    on_cluster = ("cluster.address=auto", "cluster.memory_per_task_gb=0.1", "output_dir=outputs/cluster")
    code = run_stage("evaluate", *overrides, *on_cluster)
    saboteur.join(NOTICED_WITHIN_S)
    end_s = time.monotonic() + NOTICED_WITHIN_S
    while (alive := sum(node["Alive"] for node in ray.nodes())) == said["nodes_before"] and time.monotonic() < end_s:
        time.sleep(0.5)
    print(json.dumps(said | {"nodes_after": alive}))
    sys.exit(code)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Gate(Path(sys.argv[2])), *sys.argv[3:])
