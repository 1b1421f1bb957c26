#!/bin/sh
# Tests that golden recordings of another compiler may differ only within error bounds: golden_test.sh PROGRAM FILE
set -eu
program=$1
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT

# judge STATUS EDIT FILE: pretends that another compiler wrote FILE, with other hashes of outputs and work, and applies
# EDIT.
bits='^\([a-z0-9-]* [0-9a-f]*\) [0-9a-f]* [0-9a-f]* '
judge() {
    sed -e '1s/.*/# another compiler/' -e "s/$bits/\\1 0 0 /" -e "$2" "$3" >"$dir/pinned.txt"
    status=0
    "$program" "$dir/pinned.txt" >"$dir/out.txt" || status=$?
    [ "$status" = "$1" ] || { echo "$2: exit status $status, not $1"; tail -5 "$dir/out.txt"; exit 1; }
    echo "$2: $status"
}

judge 0 '' "$2"                               # within the error bounds
judge 1 '2s/ [0-9a-f]* / 0 /' "$2"            # different input
judge 1 '/^torus/,/^cube/s/^ [^ ]*/ 1/' "$2"  # a proxy 1 m away
judge 1 '/^torus/,/^cube/s/ [^ ]*$/ nan/' "$2"                   # a force of NaN
judge 1 '/^torus/,/^cube/s/ [^ ]*$/ 9/' "$2"    # a different force
judge 1 '/^torus/d' "$2"                      # a missing recording
