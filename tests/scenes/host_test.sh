#!/usr/bin/env bash
# Tests that other projects can use the libraries: a project with headers of the same names as palpate's, with the
# installed libraries and with palpate as a subfolder; and a project with the engine only, without OpenVDB.
# host_test.sh BUILD SOURCE COMPILER
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
hosts=$2/tests/scenes
quietly() { "$@" >"$place/log" 2>&1 || { cat "$place/log"; exit 1; }; }
# configure PROJECT FOLDER COMPILER OPTION...
configure() {
    quietly cmake -S "$hosts/$1" -B "$place/$2" -G Ninja -DCMAKE_CXX_COMPILER="$3" "${@:4}"
}
# says PROJECT FOLDER COMPILER WORDS OPTION...: builds against the installed libraries. The program must print WORDS.
says() {
    configure "$1" "$2" "$3" -DCMAKE_PREFIX_PATH="$place/usr" -DCMAKE_BUILD_TYPE=Release "${@:5}"
    quietly cmake --build "$place/$2"
    local said
    said=$("$place/$2/host")
    echo "$1, $(basename "$3"): $said"
    [ "$said" = "$4" ]
}

cmake --install "$1" --prefix "$place/usr" >/dev/null
# Private headers must not be installed, and only one header may include OpenVDB.
! grep -rl "Private to" "$place/usr/include" || exit 1
[ "$(cd "$place/usr/include" && grep -rl "include.*openvdb" .)" = ./palpate/samplers/grid/make_volume.h ]
compilers=("$3")
other=$(command -v clang++ || true)
[ -z "$other" ] || compilers+=("$other")
for compiler in "${compilers[@]}"; do
    name=$(basename "$compiler")
    says host "$name" "$compiler" "simulated: force 2.00 N, proxy 40.0 mm"
    says host_engine "$name.engine" "$compiler" "force 2.00 N, proxy 40.0 mm" \
        -DCMAKE_DISABLE_FIND_PACKAGE_OpenVDB=ON -DCMAKE_DISABLE_FIND_PACKAGE_TBB=ON
done

# Builds a host in C without Eigen. Then removes the shared library, which is in another package.
"$1/bin/palpate" make two-bodies "$place/bodies.vdb" >/dev/null
configure host_c host_c "$3" -DCMAKE_PREFIX_PATH="$place/usr" -DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON
quietly cmake --build "$place/host_c"
"$place/host_c/host" "$place/bodies.vdb" | sed -n 1p
find "$place/usr" -name 'libpalpate_c.so.*' -delete
says host_engine without_c "$3" "force 2.00 N, proxy 40.0 mm" -DCMAKE_DISABLE_FIND_PACKAGE_OpenVDB=ON
if cmake -S "$hosts/host_c" -B "$place/no_c" -DCMAKE_PREFIX_PATH="$place/usr" >"$place/log" 2>&1; then
    echo "host_c was configured without the shared library"
    exit 1
fi
grep -q "install the package palpate" "$place/log"

# With palpate as a subfolder, a host must build only the libraries that it links. Lists their sources without
# compiling them.
configure host folder "$3" -DPALPATE="$2" -DPALPATE_TOGETHER=1
grep -q "CMAKE_BUILD_TYPE:STRING=$" "$place/folder/CMakeCache.txt"
sources=$(ninja -C "$place/folder" -t commands all | grep -o -- ' -c [^ ]*' | sed "s| -c $2/||")
echo "$sources" | wc -l
! echo "$sources" | grep -E "^(bench|tests/support|scenes/(apps|network|bindings|library/made))" || exit 1
[ "$(echo "$sources" | grep -c '^engine/')" -gt 30 ]
