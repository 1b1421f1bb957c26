#!/usr/bin/env bash
# Installs missing packages, builds, and runs every test. The release build runs all tests. AddressSanitizer and
# UndefinedBehaviorSanitizer run the Catch2 tests, the hostile files and a few runs of each program. ThreadSanitizer
# runs the tests of the loop and of HID arms. Random tests run a tenth of their cases; in a folder that has changed
# since the last pass all cases. Prints the minutes of each step and "N passed, N failed". Fails beyond its budget.
#   --data DIR   volumes for the tests that need real data; with it a skipped test is a failure
#   --long       random tests with ten times their cases; clang-tidy with all its checks; the packages on
#                an empty Debian
#   --install    only install the packages
set -euo pipefail
cd "$(dirname "$0")"

usage() { sed -n '2,10s/^# \{0,1\}//p' "$0"; }
install_only=
long=
while [ $# -gt 0 ]; do
    case $1 in
        --data)
            [ $# -ge 2 ] && [ -d "$2" ] || { echo "test.sh: --data needs an existing folder" >&2; exit 2; }
            PALPATE_DATA=$(cd "$2" && pwd)
            export PALPATE_DATA
            shift ;;
        --long) long=1 ;;
        --install) install_only=1 ;;
        -h | --help) usage; exit 0 ;;
        *) echo "test.sh: unknown option $1" >&2; usage >&2; exit 2 ;;
    esac
    shift
done

if [ -z "$install_only" ]; then
    echo "test.sh: builds three presets and runs every test: about 45 minutes on two cores if ccache has the"
    echo "         sources, otherwise about 110. Logs: build/PRESET/build.log, build/PRESET/runs/*/console.log"
fi
.ci/install core network vtk python test
[ -z "$install_only" ] || exit 0
. .ci/minutes
. .ci/watched
# A run with PALPATE_CASES set by the caller is not remembered as a pass of the gate.
own_cases=${PALPATE_CASES:-}

presets=(tsan dev release)
for preset in "${presets[@]}"; do
    mkdir -p build/$preset
    log=build/$preset/build.log
    echo "== building $preset"
    export CCACHE_STATSLOG=$PWD/build/$preset/ccache.log
    rm -f "$CCACHE_STATSLOG"
    : >$log
    begin
    watched "$preset: configuring" $log cmake --preset $preset -DPALPATE_TESTS=ON -DPALPATE_BENCH_ALL=OFF ||
        { cat $log; exit 1; }
    taken "$preset: configure"
    begin
    watched "$preset: building" $log cmake --build --preset $preset || { tail -60 $log; exit 1; }
    asked=$(grep -cxE 'direct_cache_hit|preprocessed_cache_hit|cache_miss' "$CCACHE_STATSLOG" 2>/dev/null) || true
    found=$(grep -cxE 'direct_cache_hit|preprocessed_cache_hit' "$CCACHE_STATSLOG" 2>/dev/null) || true
    taken "$preset: build" "${found:-0} of ${asked:-0} sources from ccache"
done
if [ -n "$long" ]; then
    export PALPATE_CASES=${own_cases:-1000%} PALPATE_LONG=1
    echo "== clang-tidy with all its checks"
    .ci/install lint long
    tests/lint.sh --all
    echo "== the packages on an empty Debian"
    tests/scenes/packages_test.sh build/release || [ $? -eq 77 ]
    echo "== the first command on another Debian"
    other=$(. /etc/os-release && [ "$VERSION_CODENAME" = trixie ] && echo bookworm || echo trixie)
    tests/debian_test.sh "$other" || [ $? -eq 77 ]
fi

export PALPATE_CASES=${PALPATE_CASES:-10%}
changed=$(tests/gate.py changed)
folders=()
# run PRESET NAME CTEST-OPTION...: runs CTest. Its output goes to the console and, with its log, to
# build/PRESET/runs/NAME.
run() {
    local preset=$1 name=$2 folder=build/$1/runs/$2 status=0
    shift 2
    rm -rf "$folder"
    mkdir -p "$folder"
    folders+=("$folder")
    echo "== testing $preset: $name"
    begin
    ctest --preset $preset --no-tests=error "$@" 2>&1 | tee "$folder/console.log" || status=$?
    echo $status >"$folder/status"
    cp build/$preset/Testing/Temporary/LastTest.log "$folder"
    taken "$preset: $name" "$(sed -n 's/.*random cases: \([0-9]*\) of.*/\1/p' "$folder/LastTest.log" |
        awk '{ n += $1 } END { print n + 0 }') random cases"
    [ $status -eq 0 ] || failed=1
}
failed=
# Some tests wait more than they compute.
jobs=$(($(nproc) + 1))
run tsan tests -j "$jobs"
run dev tests -j "$jobs"
export PALPATE_CHANGED=$changed
run release tests -j "$jobs" -LE host
# Tests that depend on how the machine schedules may fail once. Suites repeat a failed test themselves. Tests marked
# WAITS run three at a time.
run release host -j 2 -L host -LE suite --repeat until-pass:2
run release host_suites -j 3 -L suite

status=0
tests/gate.py report "$PALPATE_MINUTES" build/release/budgets.txt "${folders[@]}" >build/report.txt || status=$?
if [ $status -eq 0 ] && [ -z "$failed" ] && [ -z "$own_cases" ]; then
    tests/gate.py passed
fi
cat build/report.txt
[ -z "$failed" ] || exit 1
exit $status
