#!/usr/bin/env bash
# From nothing to a felt head: installs what is missing, builds, imports an MRI that Debian ships
# (mricron-data), feels its skin and then its brain, and says what it did. Output: out/.
set -euo pipefail
cd "$(dirname "$0")"

log=build/demo.log
echo "demo: imports an MRI of a head and has a simulated hand feel it, into out/: half a minute."
echo "      Before it, once: missing packages and the program, up to 20 minutes on two cores."
echo "      Log: $log"
.ci/install build demo
. .ci/watched
mkdir -p build
: >$log
echo "== building"
watched "building" $log cmake --preset release || { cat $log; exit 1; }
watched "building" $log cmake --build --preset release --target palpate palpate-import ||
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
