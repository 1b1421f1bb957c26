#!/usr/bin/env bash
# Draws the picture of docs/view.md: bench/view_picture.sh BIN PICTURE.png. The demo's head, touched
# from above by a hand that goes straight down. Volumes: scenes/examples/prepare head.
set -euo pipefail
[ $# -eq 2 ] || { sed -n '2,3s/^# //p' "$0" >&2; exit 2; }
bin=$(cd "$1" && pwd)
picture=$(realpath "$2")
cd "$(dirname "$0")/.."
PALPATE=$bin/palpate scenes/examples/prepare head
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
printf 't,x,y,z\n0,0.008,-0.014,0.07\n2,0.008,-0.014,0.0364\n' > "$work/top.csv"
"$bin/palpate" view out/examples/head.json --device "path:$work/top.csv" --seconds 2 \
    --picture "$work/large.png"
# Halves the size, as the page shows it.
python3 - "$work/large.png" "$picture" <<'PYTHON'
import sys

import matplotlib.image
import numpy

image = matplotlib.image.imread(sys.argv[1])[:, :, :3]
height, width = (n // 2 for n in image.shape[:2])
half = image[:2 * height, :2 * width].reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
matplotlib.image.imsave(sys.argv[2], numpy.clip(half, 0, 1))
PYTHON
