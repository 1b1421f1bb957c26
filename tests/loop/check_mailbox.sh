#!/usr/bin/env bash
# Model-checks the mailbox with Spin: check_mailbox.sh. The protocol must hold, and Spin must find three planted
# faults.
set -euo pipefail
model=$(cd "$(dirname "$0")" && pwd)/mailbox.pml
command -v spin >/dev/null || { echo "spin is not installed: apt install spin"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

# verify BREAK: prints Spin's verdict on the model with fault BREAK, over all interleavings. The caller keeps standard
# output in a variable, so messages go to standard error.
verify() {
    spin -a -DBREAK="$1" "$model" >spin.txt || { cat spin.txt >&2; exit 1; }
    cc -O2 -DSAFETY -DMEMLIM=2048 -w -o pan pan.c
    ./pan -m100000 >"pan$1.txt" || { cat "pan$1.txt" >&2; exit 1; }
    if grep -q "search depth too small\|out of memory" "pan$1.txt"; then
        echo "Spin reached its limit of depth or memory, so the check is not complete" >&2
        exit 1
    fi
    grep -o "errors: [0-9]*" "pan$1.txt" || { cat "pan$1.txt" >&2; exit 1; }
}

verdict=$(verify 0)
grep "states, stored\|transitions" pan0.txt
[ "$verdict" = "errors: 0" ] || { cat pan0.txt; echo "the protocol fails"; exit 1; }
echo "the protocol holds: $verdict"
for broken in 1 2 3; do
    verdict=$(verify $broken)
    [ "$verdict" != "errors: 0" ] || { echo "planted fault $broken was not found"; exit 1; }
    echo "planted fault $broken is found: $verdict"
done
