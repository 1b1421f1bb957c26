#!/usr/bin/env bash
# Checks the format of all .h and .cpp files, and runs clang-tidy on sources outside tests/ that have changed since they
# last passed, at most the newest 40 (see tidy.py). Checks mutate.json, the structure and the prose too. Uses a separate
# build, because another compiler's precompiled headers are unusable.
#   --all   clang-tidy on all sources, with the slow checks, before a release
set -euo pipefail
cd "$(dirname "$0")/.."

mapfile -t files < <(git ls-files '*.h' '*.cpp')
clang-format --dry-run -Werror "${files[@]}"
# Checks that the faults of mutate.py match the sources.
tests/mutate.py --check
tests/structure.py
tests/prose.py
# Text for a terminal must be printed through scenes/apps/common/say.h, which escapes it.
if git grep -nE 'fmt::print|std::c(out|err) *<<|\b(f?printf|f?puts)\(|fwrite\(.*std(out|err)' -- \
    scenes/apps/cli scenes/apps/common scenes/apps/import scenes/network ':!scenes/apps/common/say.*'; then
    echo "lint: print by scenes/apps/common/say.h" >&2
    exit 1
fi

mkdir -p build/lint
cmake -S . -B build/lint -G Ninja -DCMAKE_CXX_COMPILER_LAUNCHER= -DPALPATE_TESTS=OFF -DPALPATE_TOGETHER=1 -DPALPATE_PLUGIN_STUBS=ON \
    -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >build/lint/configure.log 2>&1 ||
    { cat build/lint/configure.log; exit 1; }
# Newest sources first: --most skips old ones, which passed on the machine of their commit.
mapfile -t sources < <(cat <(git diff HEAD --name-only -- '*.cpp') <(git log --name-only --format= -- '*.cpp') <(git ls-files '*.cpp') |
    awk '!seen[$0]++' | grep -v '^tests/' | while read -r file; do [ ! -f "$file" ] || echo "$file"; done)
tests/tidy_test.py
tests/tidy.py ${@:---most 40} build/lint "${sources[@]}"
echo "lint: ${#files[@]} files formatted"
