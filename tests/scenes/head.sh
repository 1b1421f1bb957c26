#!/usr/bin/env bash
# Imports Debian's head MRI as demo.sh does and runs the head tests on it: head.sh BIN_DIR TESTS
set -euo pipefail
images=/usr/share/mricron/templates
if [ ! -f $images/ch2.nii.gz ]; then
    echo "head: needs mricron-data"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$1/palpate" import $images/ch2.nii.gz "$work/head.vdb" --smooth 1
"$1/palpate" import $images/ch2bet.nii.gz "$work/brain.vdb" --smooth 1
cp "$(dirname "$0")/../../scenes/examples/head.json" "$work/"
# The command that `feel` prints last explains its largest force.
"$1/palpate" feel "$work/head.json" >"$work/felt"
felt=$(sed -n 's/^strongest.*(spring \([0-9.]*\) N.*/\1/p' "$work/felt")
read -ra words <<<"$(tail -1 "$work/felt")"
"$1/palpate" "${words[@]:1}" >"$work/explained"
grep -q "the spring of .* pulls with $felt N" "$work/explained"
PALPATE_HEAD=$work/head.json "$2"
