#!/bin/sh
# Golden recordings as another compiler's: the file may differ by last bits, and by no more:
# golden_test.sh PROGRAM FILE
set -eu
program=$1
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT

# By another builder, with other bits in what was felt and taken, and what is asked besides.
bits='^\([a-z0-9-]* [0-9a-f]*\) [0-9a-f]* [0-9a-f]* '
judge() {
    sed -e '1s/.*/# another compiler/' -e "s/$bits/\\1 0 0 /" -e "$2" "$3" >"$dir/pinned.txt"
    status=0
    "$program" "$dir/pinned.txt" >"$dir/out.txt" || status=$?
    [ "$status" = "$1" ] || { echo "$2: exit status $status, not $1"; tail -5 "$dir/out.txt"; exit 1; }
    echo "$2: $status"
}

judge 0 '' "$2"                               # within the bounds
judge 1 '2s/ [0-9a-f]* / 0 /' "$2"            # given something else
judge 1 '/^torus/,/^cube/s/^ [^ ]*/ 1/' "$2"  # a proxy a metre away
judge 1 '/^torus/,/^cube/s/ [^ ]*$/ nan/' "$2"                   # a force that is none
judge 1 '/^torus/,/^cube/s/ [^ ]*$/ 9/' "$2"    # another force
judge 1 '/^torus/d' "$2"                      # one that is not there
