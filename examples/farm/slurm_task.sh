#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# One task of an Open Job Description as an element of a Slurm array; submitted by slurm_submit.py. Arguments: the step's
# folder, then an `openjd run` command without its task.
#
# Bad input (2) and a failed self-check (3) would recur, so the task fails. Anything else that ends a task, such as a
# signal or a full disk (75), is worth another try, here or on another node: the task resumes from its last checkpoint.
# When a node is lost, Slurm itself does the same.
set -uo pipefail

tries=5
task=$1/$SLURM_ARRAY_TASK_ID
shift
log=$task.${SLURM_RESTART_COUNT:-0}.log # one for each try
echo "on ${SLURMD_NODENAME:-no node}" >"$log"
"$@" --tasks "file://$task.json" >>"$log" 2>&1 && exit 0

# `openjd run` ends with 1, whatever its task ended with.
code=$(sed -n 's/.* exited with code: \(-\{0,1\}[0-9]*\) .*/\1/p' "$log" | tail -n 1)
echo "$(basename "$task"): ended with ${code:-no exit code}, see $log"
case $code in
  2 | 3) exit "$code" ;;
esac
((${SLURM_RESTART_COUNT:-0} + 1 >= tries)) || scontrol requeue "$SLURM_JOB_ID"
exit 75
