#!/usr/bin/env bash
# A project outside uses the libraries, with headers of its own that are called as palpate's are:
# installed, and as a folder of its own. host_test.sh BUILD SOURCE COMPILER
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
host=$2/tests/scenes/host
configure() { cmake -S "$host" -B "$@" -G Ninja -DCMAKE_CXX_COMPILER="$compiler" >"$place/log" 2>&1 || { cat "$place/log"; exit 1; }; }
compiler=$3

cmake --install "$1" --prefix "$place/usr" >/dev/null
# Nothing private is in the way of a host, and OpenVDB in one header only.
! grep -rl "Private to" "$place/usr/include" || exit 1
[ "$(cd "$place/usr/include" && grep -rl "include.*openvdb" .)" = ./palpate/samplers/make_volume.h ]
configure "$place/installed" -DCMAKE_PREFIX_PATH="$place/usr" -DCMAKE_BUILD_TYPE=Release
cmake --build "$place/installed" >"$place/log" 2>&1 || { cat "$place/log"; exit 1; }
said=$("$place/installed/host")
echo "$said"
[ "$said" = "simulated: force 2.00 N, proxy 40.0 mm" ]

# As a folder: it builds what it links and nothing else. What that is, is not compiled once more here.
configure "$place/folder" -DPALPATE="$2"
grep -q "CMAKE_BUILD_TYPE:STRING=$" "$place/folder/CMakeCache.txt"
sources=$(ninja -C "$place/folder" -t commands all | grep -o -- ' -c [^ ]*' | sed "s| -c $2/||")
echo "$sources" | wc -l
! echo "$sources" | grep -E "^(bench|tests/support|scenes/(cli|import|made|fragments))" || exit 1
[ "$(echo "$sources" | grep -c '^engine/')" -gt 30 ]
