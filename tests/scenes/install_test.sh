#!/usr/bin/env bash
# What cmake --install puts in place works there: install_test.sh BUILD
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cmake --install "$1" --prefix "$place" >/dev/null
"$place/bin/palpate" devices | grep -q polhem
"$place/bin/palpate" make two-bodies "$place/bodies.vdb" >/dev/null
"$place/bin/palpate" info "$place/bodies.vdb" | grep -q voxels
grep -q uaccess "$place/lib/udev/rules.d/70-palpate-arms.rules"
test -f "$place/share/palpate/scene.schema.json"
"$place/bin/palpate" devices "$place/share/palpate/profiles/teensy-arm.json" | grep -q current_a
