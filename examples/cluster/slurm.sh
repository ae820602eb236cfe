#!/usr/bin/env bash
# A scan on several nodes. Activate the environment that has btr-mjx[cluster], then submit; the arguments are those of
# btr_mjx.scan without --out and --cluster:
#
#     RUN=runs/large sbatch examples/cluster/slurm.sh --parameter bl_14 --grid 1000 --trials 1000
#
# The folder that it is submitted from must be seen by all nodes. Submitted again, or requeued by SLURM, it goes on.
#SBATCH --job-name=btr-scan
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=64
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail

run=${RUN:?set RUN to the run folder of the scan}
file=$PWD/scheduler-$SLURM_JOB_ID.json
rm -f "$file" # of the same job before it was requeued
trap 'kill $(jobs -p) 2>/dev/null || true; rm -f "$file"' EXIT

dask scheduler --scheduler-file "$file" --port 0 --dashboard-address :0 &
# One worker a node and one task at a time: a task uses all cores that SLURM gives to it.
srun --cpu-bind=cores --cpus-per-task="${SLURM_CPUS_PER_TASK:-1}" dask worker --scheduler-file "$file" \
    --nworkers 1 --nthreads 1 --memory-limit 0 --local-directory "${TMPDIR:-/tmp}" &

resume=()
if [ -f "$run/config.json" ]; then resume=(--resume); fi
python -m btr_mjx.scan "$@" --out "$run" --cluster "file:$file" "${resume[@]}"
