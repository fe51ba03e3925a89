#!/bin/bash
# Run an evaluation on a Ray cluster made of a Slurm job's nodes.
#   sbatch docs/howto/cluster/slurm.sh experiment=paper output_dir=/shared/outputs/paper
# MRTASK_VENV: a virtual environment with mrtask[cluster] that all nodes can read.
#SBATCH --job-name=mrtask
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --exclusive
#SBATCH --time=02:00:00
#SBATCH --signal=B:TERM@60

set -euo pipefail
source "${MRTASK_VENV:-.venv}/bin/activate"

# Ray listens on all addresses: without a token, everybody on the network could run code as you. srun hands it on.
RAY_AUTH_TOKEN=$(python -c 'import secrets; print(secrets.token_hex(32))')
export RAY_AUTH_MODE=token RAY_AUTH_TOKEN

head=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
address=$(getent hosts "$head" | awk '{ print $1; exit }'):6379

# The head node coordinates and also plans; the others join it. Each `ray start --block` ends with the job.
srun --nodes=1 --ntasks=1 --nodelist="$head" \
    ray start --head --node-ip-address="${address%:*}" --port=6379 --block &
sleep 15
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ]; then
    srun --nodes=$((SLURM_JOB_NUM_NODES - 1)) --ntasks=$((SLURM_JOB_NUM_NODES - 1)) --exclude="$head" \
        ray start --address="$address" --block &
    sleep 15
fi

# Slurm signals this script first: hand it on, so that finished rows are written before the job is killed.
trap 'kill -TERM "$run" && wait "$run"' TERM
mrtask evaluate cluster=existing cluster.address="$address" "$@" &
run=$!
wait "$run"
