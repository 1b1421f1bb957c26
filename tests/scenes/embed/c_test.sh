#!/usr/bin/env bash
# Tests the C host, and the symbols that the shared library exports: c_test.sh BUILD HOST LIBRARY
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
"$1/bin/palpate" make two-bodies bodies.vdb >/dev/null
said=$("$2" bodies.vdb) || true
echo "$said"
[[ $said == *"at most 0."[1-9]*" N"*'why: {"'*"no_such.vdb: no such file"* ]]
said=$("$2" nowhere.vdb 2>&1) && { echo "it felt nothing at all"; exit 1; }
[[ $said == "nowhere.vdb: no such file"* ]]
# Only C names may be exported: C++ names could collide with a host's.
shown=$(nm -D --defined-only "$3" | awk '$2 ~ /[TWVBDRu]/ {print $3}' | grep -v '^palpate_' || true)
[ -z "$shown" ] || { echo "it shows $shown"; exit 1; }
[ "$(nm -D --defined-only "$3" | grep -c ' T palpate_')" = 11 ]
echo "1 passed, 0 failed"
