#!/usr/bin/env bash
# Imports Debian's head MRI as demo.sh does and runs the head tests on it: head.sh BIN_DIR TESTS
set -euo pipefail
images=/usr/share/mricron/templates
if [ ! -f $images/ch2.nii.gz ]; then
    echo "mricron-data is not there"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$1/palpate" import $images/ch2.nii.gz "$work/head.vdb" --smooth 1
"$1/palpate" import $images/ch2bet.nii.gz "$work/brain.vdb" --smooth 1
cp "$(dirname "$0")/../../scenes/examples/head.json" "$work/"
PALPATE_HEAD=$work/head.json "$2"
