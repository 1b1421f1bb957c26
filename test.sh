#!/usr/bin/env bash
# Installs what is missing, builds, and runs every test: the loop's with ThreadSanitizer, all with
# AddressSanitizer and UndefinedBehaviorSanitizer, all of the release. Ends with ctest's summary and
# its exit status.
#   --data DIR   volumes for the tests that need real data; with it a skipped test is a failure
#   --long       random tests over 300,000 cases each, of the balance over ten million
#   --install    only install the packages
set -euo pipefail
cd "$(dirname "$0")"

usage() { sed -n '2,7s/^# \{0,1\}//p' "$0"; }
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

.ci/install build test
[ -z "$install_only" ] || exit 0

for preset in tsan dev release; do
    mkdir -p build/$preset
    log=build/$preset/build.log
    echo "== building $preset"
    cmake --preset $preset -DPALPATE_TESTS=ON >$log 2>&1 || { cat $log; exit 1; }
    cmake --build --preset $preset >>$log 2>&1 || { tail -60 $log; exit 1; }
done
if [ -n "$long" ]; then
    echo "== ten million balances"
    PALPATE_CASES=10000000 build/release/tests/palpate_engine_tests "[balance]" || exit $?
    export PALPATE_CASES=300000
fi
for preset in tsan dev release; do
    echo "== testing $preset"
    status=0
    report=build/$preset/test.log
    ctest --preset $preset --no-tests=error -j "$(nproc)" 2>&1 | tee $report || status=$?
    if [ $status -eq 0 ] && [ -n "${PALPATE_DATA:-}" ] && grep -q '(Skipped)' $report; then
        echo "test.sh: a test was skipped although --data was given" >&2
        status=1
    fi
    [ $status -eq 0 ] || exit $status
done
