#!/usr/bin/env bash
# Installs what is missing, builds, and runs every test: all of the release; every path of the code
# with AddressSanitizer and UndefinedBehaviorSanitizer, over a tenth of the random cases; the loop with
# ThreadSanitizer, likewise. Ends with what its time went to, ctest's summary and its exit status.
#   --data DIR   volumes for the tests that need real data; with it a skipped test is a failure
#   --long       random tests over 300,000 cases each, of the balance over ten million; the packages on
#                an empty Debian
#   --install    only install the packages
set -euo pipefail
cd "$(dirname "$0")"

usage() { sed -n '2,9s/^# \{0,1\}//p' "$0"; }
install_only=
long=
while [ $# -gt 0 ]; do
    case $1 in
        --data)
            [ $# -ge 2 ] && [ -d "$2" ] || { echo "test.sh: --data needs a folder" >&2; exit 2; }
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
    echo "test.sh: builds three presets and runs every test; with a compiler cache that knows them some 20"
    echo "         to 40 minutes on two cores, else up to two hours. Logs: build/PRESET/build.log, test.log"
fi
.ci/install build vtk python test
[ -z "$install_only" ] || exit 0
. .ci/minutes
. .ci/watched

presets=(tsan dev release)
for preset in "${presets[@]}"; do
    mkdir -p build/$preset
    log=build/$preset/build.log
    echo "== building $preset"
    since=$SECONDS
    export CCACHE_STATSLOG=$PWD/build/$preset/ccache.log
    rm -f "$CCACHE_STATSLOG"
    : >$log
    watched "$preset: configuring" $log cmake --preset $preset -DPALPATE_TESTS=ON ||
        { cat $log; exit 1; }
    taken $since "$preset: configure"
    since=$SECONDS
    watched "$preset: building" $log cmake --build --preset $preset || { tail -60 $log; exit 1; }
    asked=$(grep -cxE 'direct_cache_hit|preprocessed_cache_hit|cache_miss' "$CCACHE_STATSLOG" 2>/dev/null) || true
    found=$(grep -cxE 'direct_cache_hit|preprocessed_cache_hit' "$CCACHE_STATSLOG" 2>/dev/null) || true
    taken $since "$preset: build" "${found:-0} of ${asked:-0} sources out of ccache"
done
if [ -n "$long" ]; then
    echo "== ten million balances"
    PALPATE_CASES=10000000 build/release/tests/palpate_engine_tests "[balance]" || exit $?
    export PALPATE_CASES=300000
    echo "== the packages on an empty Debian"
    .ci/install long
    tests/scenes/packages_test.sh build/release || [ $? -eq 77 ]
fi
for preset in "${presets[@]}"; do
    echo "== testing $preset"
    report=build/$preset/test.log
    reports=(${reports[@]+"${reports[@]}"} $report)
    # The sanitizers make a case several times as slow.
    cases=${PALPATE_CASES:-10%}
    [ $preset != release ] || cases=${PALPATE_CASES:-100%}
    since=$SECONDS
    status=0
    # Its closing lines come last, after the table.
    PALPATE_CASES=$cases ctest --preset $preset --no-tests=error -j "$(nproc)" 2>&1 |
        tee $report | sed '/% tests passed/,$d' || status=$?
    ran=$(sed -n 's/.*random cases: \([0-9]*\) of.*/\1/p' build/$preset/Testing/Temporary/LastTest.log |
        awk '{ n += $1 } END { print n + 0 }') || true
    taken $since "$preset: tests" "$(grep -c '^ *[0-9]*/[0-9]* Test' $report) tests, $ran random cases"
    if [ $status -eq 0 ] && [ -n "${PALPATE_DATA:-}" ] && grep -q '(Skipped)' $report; then
        taken $SECONDS "$preset: SKIPPED" "a test was skipped although --data was given: a failure"
        status=1
    fi
    if [ $status -ne 0 ] || [ $preset = release ]; then
        tests/minutes.py "$PALPATE_MINUTES" "${reports[@]}"
    fi
    sed -n '/% tests passed/,$p' $report
    [ $status -eq 0 ] || exit $status
done
