#!/usr/bin/env bash
# Runs a command while a program on each core computes and never waits: beside_neighbours.sh COMMAND...
# What a test says must hold there too, and not only on a machine that does nothing else.
set -uo pipefail
for tool in setpriv taskset; do
    command -v $tool >/dev/null || { echo "beside_neighbours: no $tool" >&2; exit 1; }
done
neighbours=()
trap 'kill -KILL "${neighbours[@]}" 2>/dev/null' EXIT
for ((core = 0; core < $(nproc); ++core)); do
    setpriv --pdeathsig KILL taskset -c "$core" sh -c 'while :; do :; done' &
    neighbours+=($!)
done
"$@"
