#!/usr/bin/env bash
# Tests the contents and dependencies of the .debs that cpack makes: deb_test.sh BUILD
set -euo pipefail
command -v dpkg-shlibdeps >/dev/null || { echo "debs: needs dpkg-dev"; exit 77; }
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$1"
# Packs without compression, which would take most of the time.
cpack -G DEB -B "$place" -D CPACK_DEBIAN_COMPRESSION_TYPE=none >"$place/log" 2>&1 || { cat "$place/log"; exit 1; }
cd "$place"
wants() { dpkg-deb -f "$1"_*.deb Depends; }
# grep -q would exit early, so that the program before it would fail under pipefail. So grep writes to /dev/null.
holds() { dpkg-deb -c "$1"_*.deb | awk '{print $6}' | grep -x "$2" >/dev/null || { echo "$1 lacks $2"; exit 1; }; }
fail() { echo "debs: $*"; exit 1; }

holds palpate ./usr/bin/palpate
holds palpate ./usr/bin/palpate-import-light
holds palpate ./usr/lib/udev/rules.d/70-palpate-arms.rules
holds palpate ./usr/share/man/man1/palpate-feel.1
holds palpate ./usr/share/palpate/palpate-limits.conf
holds palpate ./usr/share/palpate/trace_picture.py
holds palpate ./usr/share/palpate/picture_style.py
! dpkg-deb -c palpate_*.deb | grep "usr/bin/.*py$" || fail "usr/bin, which is in PATH, has drawing scripts"
holds libpalpate-dev ./usr/include/palpate/scenes/palpate.h
holds libpalpate-dev ./usr/include/palpate/scenes/bindings/c/c_api.h
holds palpate "./usr/lib/.*libpalpate_c.so.0"
holds libpalpate-dev "./usr/lib/.*libpalpate_c.so"
for each in *.deb; do
    name=${each%%_*}
    holds "$name" "./usr/share/doc/$name/copyright"
    [ "$(dpkg-deb -c "$each" | awk '{print $2}' | sort -u)" = root/root ] || fail "$each has files of other users"
done
for each in palpate*.deb python3*.deb; do
    ! dpkg-deb -f "$each" Depends | grep -- -dev || fail "$each depends on a -dev package"
done
[ "$(wants libpalpate-dev)" = "libeigen3-dev (>= 3.4)" ] || fail "libpalpate-dev depends on more than Eigen"
! wants palpate | grep vtk >/dev/null || fail "palpate depends on VTK"
! wants palpate | grep -E "curl|dds|hdf5|mpi|rados" >/dev/null || fail "palpate depends on the library of a module"
if ls palpate-network_*.deb >/dev/null 2>&1; then
    for module in "$1"/lib/palpate/*.so; do holds palpate-network "./usr/lib/palpate/${module##*/}"; done
    wants palpate-network | grep -F "palpate (= " >/dev/null || fail "palpate-network allows any release of palpate"
fi
if ls palpate-import_*.deb >/dev/null 2>&1; then
    wants palpate-import | grep vtk >/dev/null || fail "palpate-import does not depend on VTK"
fi
if ls palpate-view_*.deb >/dev/null 2>&1; then
    holds palpate-view ./usr/bin/palpate-view
    wants palpate-view | grep -i vtk >/dev/null || fail "palpate-view does not depend on VTK"
fi
holds palpate ./usr/share/palpate/examples/prepare
dpkg-deb -c palpate_*.deb | grep "^-rwx.*examples/prepare$" >/dev/null || fail "the script prepare is not executable"
for page in index.md interfaces.md charts/view.png; do holds palpate-doc "./usr/share/doc/palpate/book/$page"; done
# Files that the package has according to docs/plugins.md and docs/embed.md.
for each in sample.c plugin.h answer.h newest.h openhaptics.cpp dhd.cpp nifalcon.cpp known_arms.json; do
    holds palpate-doc "./usr/share/doc/palpate/plugins/$each"
done
for each in embed/host.c host/main.cpp host_engine/main.cpp session.py first_tick.cpp; do
    holds palpate-doc "./usr/share/doc/palpate/programs/$each"
done
[ "$(dpkg-deb -f palpate-doc_*.deb Architecture)" = all ] || fail "the architecture of palpate-doc is not \"all\""
if [ -e "$1/plugins/haply.so" ]; then holds palpate-haply ./usr/lib/palpate/plugins/haply.so; fi
# Members of the group realtime get the limits that the loop requests. An administrator's file is kept.
dpkg-deb -e palpate_*.deb control
[ "$(cat control/triggers)" = "activate-noawait ldconfig" ] || fail "palpate does not run ldconfig"
sh -n control/postinst && sh -n control/postrm
grep -q "addgroup --system --quiet realtime" control/postinst
for each in *.deb; do
    echo "$each: $(($(dpkg-deb -f "$each" Installed-Size) / 1024)) MB, $(($(stat -c %s "$each") / 1024)) KB"
done
