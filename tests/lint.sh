#!/usr/bin/env bash
# clang-format on every file, clang-tidy on every source outside tests/ that has not passed it as it
# is (see tidy.py). Configures a build of its own, so that no precompiled header of another compiler
# is in the way.
#   --all   clang-tidy on all of them and with the slow checks, before a release
set -euo pipefail
cd "$(dirname "$0")/.."

mapfile -t files < <(git ls-files '*.h' '*.cpp')
clang-format --dry-run -Werror "${files[@]}"
# The faults that mutate.py plants still fit: seconds here, a whole gate where ctest finds it last.
tests/mutate.py --check
# Text for a terminal goes by scenes/cli/say.h, which makes it fit for one.
if git grep -nE 'fmt::print|std::c(out|err) *<<|\b(f?printf|f?puts)\(|fwrite\(.*std(out|err)' -- \
    scenes/cli scenes/import ':!scenes/cli/say.*'; then
    echo "lint: print by scenes/cli/say.h" >&2
    exit 1
fi

mkdir -p build/lint
cmake -S . -B build/lint -G Ninja -DCMAKE_CXX_COMPILER_LAUNCHER= -DPALPATE_TESTS=OFF -DPALPATE_TOGETHER=1 -DPALPATE_PLUGIN_STUBS=ON \
    -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >build/lint/configure.log 2>&1 ||
    { cat build/lint/configure.log; exit 1; }
mapfile -t sources < <(git ls-files '*.cpp' | grep -v '^tests/')
# All sources take 20 minutes. They passed on the machine where they were committed: on one that has
# no stamps yet, this run checks the newest, and the next run the rest.
if [ "$#" -eq 0 ] && [ ! -d "${XDG_CACHE_HOME:-$HOME/.cache}/palpate/tidy" ]; then
    mapfile -t sources < <(git log -30 --name-only --format= -- '*.cpp' | sort -u |
        grep -v '^tests/' | while read -r file; do [ ! -f "$file" ] || echo "$file"; done)
fi
tests/tidy_test.py
tests/tidy.py "$@" build/lint "${sources[@]}"
echo "lint: ${#files[@]} files formatted, ${#sources[@]} sources tidy"
