#!/usr/bin/env bash
# Imports real data and runs the motion tests on them: data_test.sh PALPATE MOTION_TESTS
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$1" import "$PALPATE_DATA/flow_carotid/carotid.vtk" "$folder/carotid.vdb"
"$1" import "$PALPATE_DATA/cfd_kitchen/kitchen.vtk" "$folder/kitchen.vdb"
"$1" import "$PALPATE_DATA/storm_dx/wind.dx" "$folder/storm.vdb" --raw \
    '{"size": [8, 14, 25], "type": "float32", "endian": "big", "components": 3,
      "skip": {"after": "\nend\n"}, "name": "wind"}'
"$1" import "$PALPATE_DATA/ct_headsq/quarter.nhdr" "$folder/head.vdb"
PALPATE_IMPORTED="$folder" "$2" "[data]"
