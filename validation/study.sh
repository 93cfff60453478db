#!/bin/sh
# A study as Slurm arrays that share a run folder: sh study.sh STUDY.toml RUN PARTS
# First what all trials share, then the trials, then the tables; what was killed goes on when this is submitted again.
set -eu
study=$1 run=$2 parts=$3
common="--parsable --ntasks=1 --cpus-per-task=2 --mem-per-cpu=4G --time=24:00:00 --requeue"
part='--part $SLURM_ARRAY_TASK_ID'/$parts
first=$(sbatch $common --array="1-$parts" --job-name=predict \
    --wrap "bcid-validate study '$study' -o '$run' $part --predict-only --jobs 2")
second=$(sbatch $common --array="1-$parts" --job-name=trials --dependency="afterok:$first" \
    --wrap "bcid-validate study '$study' -o '$run' $part --jobs 2")
sbatch $common --job-name=tables --dependency="afterok:$second" --wrap "bcid-validate study '$study' -o '$run'"
