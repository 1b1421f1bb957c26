#!/usr/bin/env bash
# Real flows, imported and followed: data_test.sh PALPATE MOTION_TESTS
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$1" import "$PALPATE_DATA/flow_carotid/carotid.vtk" "$folder/carotid.vdb"
"$1" import "$PALPATE_DATA/cfd_kitchen/kitchen.vtk" "$folder/kitchen.vdb"
"$1" import "$PALPATE_DATA/storm_dx/wind.dx" "$folder/storm.vdb" --raw \
    '{"size": [8, 14, 25], "type": "float32", "endian": "big", "components": 3,
      "skip": {"after": "\nend\n"}, "name": "wind"}'
PALPATE_FLOWS="$folder" "$2" "[data]"
