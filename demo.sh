#!/usr/bin/env bash
# The demo: installs missing packages, builds, and imports an MRI of a head that Debian ships (mricron-data). Then a
# simulated hand presses on the skin and on the brain. Reports each step. Output: out/.
# demo.sh --all also builds the window, the importer with VTK (DICOM, meshes), the Python module, and what needs a
# network: volumes from web servers and Ceph, hands at several sites, imports by several processes.
set -euo pipefail
cd "$(dirname "$0")"

groups=(core demo)
targets=(palpate palpate-import-light)
case "${1:-}" in
    "") ;;
    --all)
        groups+=(network vtk python)
        targets+=(palpate-import palpate-view palpate_python) ;;
    *)
        echo "demo: unknown option $1: use ./demo.sh, or ./demo.sh --all" >&2
        exit 2 ;;
esac
log=build/demo.log
echo "demo: imports an MRI of a head and lets a simulated hand feel it. This takes half a minute. Output: out/"
echo "      The first run installs missing packages and builds the program."
echo "      Log: $log"
.ci/install "${groups[@]}"
. .ci/watched
mkdir -p build
: >$log
echo "== building"
watched "building" $log cmake --preset release || { cat $log; exit 1; }
watched "building" $log cmake --build --preset release --target "${targets[@]}" ||
    { tail -40 $log; exit 1; }

palpate=build/release/bin/palpate
images=/usr/share/mricron/templates
mkdir -p out
cp scenes/examples/head.json out/
echo "== the volumes: an MRI of a head, and the same with the skull stripped, lightly smoothed"
$palpate import $images/ch2.nii.gz out/head.vdb --smooth 1
$palpate import $images/ch2bet.nii.gz out/brain.vdb --smooth 1
echo "== the scene: what a tick samples, and why"
$palpate check out/head.json
echo "== the touch: 20 s in virtual time, a relaxed hand that presses, slides, and presses harder"
$palpate feel out/head.json --seconds 20 \
    --trace out/trace.csv --summary out/summary.json --picture out/felt.png
echo "== written: out/trace.csv (every tick), out/summary.json, out/felt.png (the picture)"
