#!/usr/bin/env bash
# Compares the importer without VTK with the one with VTK: light_test.sh BIN_DIR
set -euo pipefail
light=$1/palpate-import-light
whole=$1/palpate-import
image=/usr/share/mricron/templates/ch2.nii.gz
if [ ! -f $image ]; then
    echo "mricron-data is not installed"
    exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

! ldd "$light" | grep -i vtk || { echo "palpate-import-light loads VTK"; exit 1; }
# Not grep -q: it exits early, so that ldd fails under pipefail.
ldd "$whole" | grep -i vtk >/dev/null || { echo "palpate-import does not load VTK: nothing to compare"; exit 1; }
"$light" $image "$work/light.vdb" --smooth 1 --json >"$work/light.json"
"$whole" $image "$work/whole.vdb" --smooth 1 --json >"$work/whole.json"
# Skips the random id that OpenVDB writes into every file, and the header before it.
cmp --ignore-initial=57 "$work/light.vdb" "$work/whole.vdb"
diff <(sed 's/light\.vdb//; /"peak"/d' "$work/light.json") \
    <(sed 's/whole\.vdb//; /"peak"/d' "$work/whole.json")

# `palpate import` runs the program with VTK if it is installed, otherwise the light one.
cp "$1/palpate" "$work/"
cp "$light" "$work/"
"$work/palpate" import $image "$work/verb.vdb" >/dev/null
printf '# vtk DataFile Version 3.0\nx\nASCII\n' >"$work/a.vtk"
said=$("$work/palpate" import "$work/a.vtk" "$work/a.vdb" 2>&1) && { echo "a .vtk was imported without VTK"; exit 1; }
[[ $said == *"without VTK"*"install the package palpate-import"* ]] || { echo "unexpected message: $said"; exit 1; }
[ ! -e "$work/a.vdb" ]
echo "1 passed, 0 failed"
