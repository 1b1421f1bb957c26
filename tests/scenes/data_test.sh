#!/usr/bin/env bash
# Runs info, check, feel and sample on every real .vdb of PALPATE_DATA: data_test.sh PALPATE
set -euo pipefail
count=0
for file in "$PALPATE_DATA"/vdb/*.vdb; do
    "$1" info "$file"
    "$1" check "$file"
    "$1" feel "$file" --seconds 5 --json |
        python3 -c 'import json, sys
s = json.load(sys.stdin)
# The simulated hand visits the places of the largest forces. In rugged fog, up to 2 % of the ticks may reach the limit
# of sub-steps.
assert s["ticks"] == 5000 and s["status"]["converged"] >= 4900, s
assert s["force_max"] > 0.05 and any(f["touches"] for f in s["felt"]), s'
    for grid in $("$1" info "$file" --json |
        python3 -c 'import json, sys; print(*(g["name"] for g in json.load(sys.stdin)["grids"]))'); do
        [ "$(printf 'x,y,z\n0,0,0\n0.1,0.2,0.3\n' |
            "$1" sample "$file" --grid "$grid" --points - | wc -l)" = 3 ]
    done
    count=$((count + 1))
done
[ $count -ge 4 ] || { echo "only $count volumes in $PALPATE_DATA/vdb"; exit 1; }
