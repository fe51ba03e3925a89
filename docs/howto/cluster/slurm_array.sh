#!/bin/bash
# Run the cells of a sweep as a Slurm array: one cell a job, each on a node of its own, and one store for all.
#   sbatch docs/howto/cluster/slurm_array.sh experiment=paper output_dir=s3://bucket/sweep
#   mrtask report output_dir=s3://bucket/sweep      # compares the cells, when all jobs have ended
# MRTASK_VENV: a virtual environment with mrtask[pipeline,s3] that all nodes can read.
#SBATCH --job-name=mrtask
#SBATCH --array=0-5
#SBATCH --nodes=1
#SBATCH --exclusive
#SBATCH --time=02:00:00
#SBATCH --signal=B:TERM@60

set -euo pipefail
source "${MRTASK_VENV:-.venv}/bin/activate"

# choice(...) marks a key as swept, so that each job is a sweep of one cell, and its folder has the cell's name.
cells=()
for samples in 100 1000 10000; do
    for robots in 1 2; do
        cells+=("planner.pouct.samples=choice($samples) evaluation.robots=choice([$robots])")
    done
done
read -ra cell <<<"${cells[$SLURM_ARRAY_TASK_ID]}"

# Slurm signals this script first: hand it on, so that finished rows are written before the job is killed.
trap 'kill -TERM "$run" && wait "$run"' TERM
mrtask evaluate -m "${cell[@]}" "$@" &
run=$!
wait "$run"
