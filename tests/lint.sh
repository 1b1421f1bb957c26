#!/usr/bin/env bash
# Runs clang-format on every file, and clang-tidy on sources outside tests/ that have not passed unchanged before, at
# most the newest 60 (see tidy.py). Uses its own build, because it must not read another compiler's precompiled headers.
#   --all   clang-tidy on all sources, with the slow checks, before a release
set -euo pipefail
cd "$(dirname "$0")/.."

mapfile -t files < <(git ls-files '*.h' '*.cpp')
clang-format --dry-run -Werror "${files[@]}"
# Checks that the faults of mutate.py match the sources. This takes seconds; ctest does the same at the end of the gate.
tests/mutate.py --check
# Checks that no source includes a header of a higher folder.
tests/structure.py
# Checks the prose.
tests/prose.py
# Text for a terminal is printed through scenes/apps/common/say.h, which escapes it.
if git grep -nE 'fmt::print|std::c(out|err) *<<|\b(f?printf|f?puts)\(|fwrite\(.*std(out|err)' -- \
    scenes/apps/cli scenes/apps/common scenes/apps/import scenes/network ':!scenes/apps/common/say.*'; then
    echo "lint: print by scenes/apps/common/say.h" >&2
    exit 1
fi

mkdir -p build/lint
cmake -S . -B build/lint -G Ninja -DCMAKE_CXX_COMPILER_LAUNCHER= -DPALPATE_TESTS=OFF -DPALPATE_TOGETHER=1 -DPALPATE_PLUGIN_STUBS=ON \
    -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >build/lint/configure.log 2>&1 ||
    { cat build/lint/configure.log; exit 1; }
# The newest sources come first, so that --most omits old ones, which passed on the machine of their commit.
mapfile -t sources < <(cat <(git diff HEAD --name-only -- '*.cpp') <(git log --name-only --format= -- '*.cpp') <(git ls-files '*.cpp') |
    awk '!seen[$0]++' | grep -v '^tests/' | while read -r file; do [ ! -f "$file" ] || echo "$file"; done)
tests/tidy_test.py
tests/tidy.py ${@:---most 60} build/lint "${sources[@]}"
echo "lint: ${#files[@]} files formatted"
