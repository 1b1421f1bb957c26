#!/usr/bin/env bash
# Tests the installed files, verb by verb: install_test.sh BUILD [PYTHON]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cmake --install "$1" --prefix "$place/usr" >/dev/null
cd "$place"
palpate=$place/usr/bin/palpate
echo '{"stiffness":500,"probe":[0,0,-0.001],"primitives":[]}' >balance.jsonl
printf 'x,y,z\n0,0,0\n' >points.csv
"$palpate" make two-bodies bodies.vdb >/dev/null
# The verbs, each with a text that its output must have. The loop below reports verbs that are missing here.
declare -A says=(
    [info]=voxels [brick]=stored [sample]=gx [solve]='"force"' [check]=samples [explain]=spring [press]=depth
    [feel]=ticks [plot]=bodies [stability]=stable [devices]=polhem [schema]='"$schema"'
    [compare]="last bit" [convert]=force_z
    [make]=voxels [import]=voxels [view]=contact [scene]=isosurface [help]=--trace)
run() {
    case $1 in
        info) "$palpate" info bodies.vdb ;;
        brick) "$palpate" brick bodies.vdb bricks --grid cloud && "$palpate" info bricks ;;
        sample) "$palpate" sample bodies.vdb --grid cloud --points points.csv ;;
        solve) "$palpate" solve balance.jsonl ;;
        check) "$palpate" check bodies.vdb ;;
        explain) "$palpate" explain bodies.vdb --at 0,0,0.02 --push 0,0,-0.001 ;;
        press) "$palpate" press bodies.vdb --at 0,0,0.06 --along 0,0,-0.02 ;;
        feel) "$palpate" feel bodies.vdb --seconds 1 ;;
        # Without the window, the verb names the package to install.
        view) if [ -x usr/bin/palpate-view ]; then
                "$palpate" view bodies.vdb --seconds 1 --picture view.png && test -s view.png
            else
                ! "$palpate" view bodies.vdb && echo "no contact: the window is not installed"
            fi ;;
        plot) "$palpate" feel bodies.vdb --seconds 1 --trace bodies.csv >/dev/null &&
            "$palpate" plot bodies.csv --out bodies.png && test -s bodies.png ;;
        compare) "$palpate" feel bodies.vdb --seconds 1 --record bodies.rec >/dev/null &&
            "$palpate" feel bodies.rec --device replay:bodies.rec --record again.rec >/dev/null &&
            "$palpate" compare bodies.rec again.rec ;;
        convert) "$palpate" feel bodies.vdb --seconds 1 --record table.rec >/dev/null &&
            "$palpate" convert table.rec - && { ! "$palpate" convert table.rec table.h5 2>no.h5 &&
                grep "palpate_hdf5.so is missing" no.h5 || [ "$(head -c 4 table.h5)" = $'\x89HDF' ]; } ;;
        stability) "$palpate" stability --size 9 --map map.json ;;
        devices) "$palpate" devices ;;
        schema) "$palpate" schema scene ;;
        help) "$palpate" help feel ;;
        scene) "$palpate" scene bodies.vdb ;;
        make) "$palpate" make fibres fibres.vdb ;;
        import)
            head -c 4096 "$palpate" >block.raw
            "$palpate" import block.raw block.vdb --raw '{"size":[16,16,16],"type":"uint8"}' &&
                "$palpate-import-light" block.raw light.vdb \
                    --raw '{"size":[16,16,16],"type":"uint8"}' ;;
        *) echo "install: this test has no command for the verb $1" >&2; return 1 ;;
    esac
}
for verb in $("$palpate" --help | sed -n '/^Subcommands:/,/^$/s/^  \([a-z]*\) .*/\1/p'); do
    run "$verb" >"said.$verb" 2>&1 || { echo "install: $verb:"; cat "said.$verb"; exit 1; }
    grep -qF -- "${says[$verb]}" "said.$verb" ||
        { echo "install: the output of $verb lacks ${says[$verb]}:"; head "said.$verb"; exit 1; }
done

# The installed script `prepare` makes an example in the current folder.
usr/share/palpate/examples/prepare two_bodies >prepared
"$palpate" check out/examples/two_bodies.json >checked

grep -q uaccess usr/lib/udev/rules.d/70-palpate-arms.rules
"$palpate" devices usr/share/palpate/profiles/teensy-arm.json | grep current_a >/dev/null
test -f usr/share/palpate/scene.schema.json
# Features that few users need are in modules, so the program loads few libraries.
ldd "$palpate" >libraries
[ "$(wc -l <libraries)" -le 25 ] || { echo "install: palpate loads more than 25 libraries:"; cat libraries; exit 1; }
! grep -E "curl|ddsc|iceoryx|hdf5|mpi|rados|ceph" libraries ||
    { echo "install: palpate must load these libraries only in modules"; exit 1; }
for library in usr/lib/palpate/*.so; do
    [ ! -e "$library" ] || [ "$(nm -D --defined-only "$library" | awk '{print $3}')" = palpate_module ] ||
        { echo "install: $library exports more than palpate_module"; exit 1; }
done
PALPATE_MODULES=$place/none "$palpate" info http://localhost/none 2>without || true
grep -q "install the package palpate-network" without
# Drawing scripts must not be in PATH.
for script in feel stability trace; do test -x usr/share/palpate/${script}_picture.py; done
! ls usr/bin/*.py 2>/dev/null || { echo "install: usr/bin, which is in PATH, has drawing scripts"; exit 1; }
if [ -d usr/share/man/man1 ]; then
    for verb in said.*; do
        page=usr/share/man/man1/palpate-${verb#said.}.1
        grep -q "^palpate-${verb#said.} " "$page" || { echo "install: $page does not name its verb"; exit 1; }
    done
    grep -q smooth usr/share/man/man1/palpate-import.1
    if command -v groff >/dev/null; then
        for page in usr/share/man/man1/*.1; do groff -man -ww -Tutf8 "$page" 2>&1 >/dev/null; done >pages
        [ ! -s pages ] || { echo "install: warnings of groff about the manual pages:"; cat pages; exit 1; }
    fi
fi
# A C host finds the header and the library. With sanitizers the host would have to link them, too.
shared=$(dirname "$(find "$place/usr" -name libpalpate_c.so)")
if ! ldd "$shared/libpalpate_c.so" | grep libasan >/dev/null; then
    "${CC:-cc}" -std=c99 -Wall -Wextra -Wpedantic -Werror -Iusr/include "$here/embed/host.c" -fsyntax-only
    # The command of docs/embed.md, with its options for a prefix P.
    page=$(tr '\n' ' ' <"$here/../../docs/embed.md")
    build=$(grep -o 'cc -std=c99 host\.c -lpalpate_c' <<<"$page")
    prefix=$(grep -oe '-IP/include -LP/lib -Wl,-rpath,P/lib' <<<"$page")
    prefix=${prefix//P\/lib/$shared}
    cp "$(find usr -path '*/programs/embed/host.c')" .
    # shellcheck disable=SC2086
    $build ${prefix//P\/include/$place/usr/include}
    ./a.out bodies.vdb | grep "at most 0" >/dev/null
fi
module=$(find usr -name 'palpate.*.so')
if [ -n "$module" ]; then
    PYTHONPATH=$(dirname "$module") "$2" -c 'import palpate; palpate.Scene.load("bodies.vdb").step(0, 0, 0)'
fi
