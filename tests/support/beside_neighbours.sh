#!/usr/bin/env bash
# Runs a command while a program on each core computes without pauses: beside_neighbours.sh COMMAND... Tests must also
# pass on a busy machine.
set -uo pipefail
for tool in setpriv taskset; do
    command -v $tool >/dev/null || { echo "beside_neighbours: the command $tool is not installed" >&2; exit 1; }
done
neighbours=()
trap 'kill -KILL "${neighbours[@]}" 2>/dev/null' EXIT
for ((core = 0; core < $(nproc); ++core)); do
    setpriv --pdeathsig KILL taskset -c "$core" sh -c 'while :; do :; done' &
    neighbours+=($!)
done
"$@"
