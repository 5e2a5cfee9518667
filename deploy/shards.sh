#!/bin/sh
# A sweep in ten shards, as an array of jobs of SLURM or PBS (docs/clusters.md). SHARDS=40 in the
# environment makes another number. Any of them is submitted again by its number: sbatch --array=7 or
# --array=3,7. All words of
# `concord sweep` but --shard, --workers and --out come behind the name of this file:
#   sbatch deploy/shards.sh --scenario oscillator --runs 1000000 --keep moments
#   qsub -v SWEEP="--scenario oscillator --runs 1000000 --keep moments" deploy/shards.sh
# A job that was killed goes on with its finished pieces when it is submitted again.
#SBATCH --job-name=concord
#SBATCH --array=1-10
#SBATCH --cpus-per-task=4
#SBATCH --mem=4G
#SBATCH --time=04:00:00
#SBATCH --output=shard%a.log
#PBS -N concord
#PBS -J 1-10
#PBS -l select=1:ncpus=4:mem=4gb
#PBS -l walltime=04:00:00
set -eu
cd "${PBS_O_WORKDIR:-.}"
if [ $# -eq 0 ]; then
    # PBS passes no words: they are in a variable, and have no spaces of their own.
    set -- $SWEEP
fi
number=${SLURM_ARRAY_TASK_ID:-${PBS_ARRAY_INDEX:-}}
# The number of shards is that of the sweep: a submission may have some of them only.
shards=${SHARDS:-10}
export OPENBLAS_NUM_THREADS=1
exec concord sweep "$@" --shard "$number/$shards" --out "shard$number.nc" \
    --workers "${SLURM_CPUS_PER_TASK:-${NCPUS:-1}}"
