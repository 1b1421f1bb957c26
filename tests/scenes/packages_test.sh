#!/usr/bin/env bash
# Installs the .debs with apt on an empty Debian of this release, made by debootstrap: packages_test.sh BUILD. Then
# imports a head, runs palpate feel on it, and computes its forces from Python. Prints seconds and megabytes, and
# compares the megabytes with docs/packages.md. Exits with 77 without root, debootstrap or mricron-data; fails without
# the network. For ./test.sh --long.
set -euo pipefail
[ "$(id -u)" -eq 0 ] && command -v debootstrap >/dev/null || { echo "packages: needs root and debootstrap"; exit 77; }
image=/usr/share/mricron/templates/ch2.nii.gz
[ -f $image ] || { echo "packages: needs mricron-data"; exit 77; }
pages=$(cd "$(dirname "$0")/../../docs" && pwd)
place=$(mktemp -d)
root=$place/root
debs=$place/debs
# No file system with data is mounted below the folder, so removing it is safe.
cleanup() {
    umount "$root/proc" 2>/dev/null || true
    rm -rf --one-file-system "$place"
}
trap cleanup EXIT
megabytes() { du -sk --one-file-system "$root" | awk '{ printf "%.1f", $1 / 1024 }'; }
wrong=""
# Compares a package's size [MB] with the number in the last column of docs/packages.md, to 10 % and its rounding.
compare() {
    local listed
    listed=$(awk -F'|' -v name=" \`$1\` " '$2 == name { print $4 + 0 }' "$pages/packages.md")
    awk -v a="$2" -v b="$listed" 'BEGIN { d = a - b; exit !((d < 0 ? -d : d) <= 0.1 * b + 0.05) }' ||
        wrong+="packages: $1: $2 MB, but docs/packages.md states $listed MB"$'\n'
}
quietly() { "$@" >>"$place/log" 2>&1 || { tail -40 "$place/log"; exit 1; }; }

(cd "$1" && quietly cpack -G DEB -B "$debs")
. /etc/os-release
# Uses the mirror from which this machine gets its packages.
from=$(apt-get indextargets --format '$(SITE) $(RELEASE)' 'Created-By: Packages' |
    awk -v r="$VERSION_CODENAME" '$2 == r { print $1; exit }')
since=$SECONDS
quietly debootstrap --variant=minbase "$VERSION_CODENAME" "$root" "$from"
cp -rL /etc/apt/. "$root/etc/apt/"
cp -L /etc/resolv.conf "$root/etc/" 2>/dev/null || true
quietly chroot "$root" apt-get clean
rm -rf "$root"/var/lib/apt/lists/*
echo "empty $PRETTY_NAME: $(megabytes) MB, $((SECONDS - since)) s"

mount -t proc proc "$root/proc"
quietly chroot "$root" apt-get -qq update
install() {
    local before size since=$SECONDS
    before=$(megabytes)
    cp "$debs/$1"_*.deb "$root/"
    quietly chroot "$root" env DEBIAN_FRONTEND=noninteractive \
        apt-get -qq install -y --no-install-recommends "./$(basename "$debs/$1"_*.deb)"
    quietly chroot "$root" apt-get clean
    size=$(awk -v a="$(megabytes)" -v b="$before" 'BEGIN { printf "%.1f", a - b }')
    # The table states the sizes of the last three packages without dependencies.
    case $1 in
        palpate-haply | palpate-doc | libpalpate-dev)
            size=$(chroot "$root" dpkg-query -W -f '${Installed-Size}' "$1" | awk '{ printf "%.1f", $1 / 1024 }') ;;
    esac
    echo "$1: $size MB, $((SECONDS - since)) s"
    compare "$1" "$size"
}
install palpate
[ -n "$(chroot "$root" getent group realtime)" ]
grep -q rtprio "$root/etc/security/limits.d/palpate.conf"
chroot "$root" palpate make two-bodies /bodies.vdb >/dev/null
chroot "$root" palpate feel /bodies.vdb --seconds 2 | sed -n 1p
cp $image "$root/head.nii.gz"
chroot "$root" palpate import /head.nii.gz /head.vdb --smooth 1 | sed -n 1p
chroot "$root" palpate feel /head.vdb --seconds 5 | sed -n 1p
cat >"$root/cloud.vtk" <<'END'
# vtk DataFile Version 3.0
a ramp
ASCII
DATASET STRUCTURED_POINTS
DIMENSIONS 3 3 3
ORIGIN 0 0 0
SPACING 1 1 1
POINT_DATA 27
SCALARS ramp float 1
LOOKUP_TABLE default
1 2 3 4 5 6 7 8 9 1 2 3 4 5 6 7 8 9 1 2 3 4 5 6 7 8 9
END
chroot "$root" palpate import /cloud.vtk /cloud.vdb >"$place/said" 2>&1 || true
grep -q "install the package palpate-import" "$place/said" || { cat "$place/said"; exit 1; }
chroot "$root" palpate feel /bodies.vdb --seconds 1 --record /hand.rec >/dev/null
chroot "$root" palpate convert /hand.rec /hand.h5 >"$place/said" 2>&1 || true
grep -q "install the package palpate-network" "$place/said" || { cat "$place/said"; exit 1; }
install palpate-network
chroot "$root" palpate convert /hand.rec /hand.h5
[ "$(head -c 4 "$root/hand.h5")" = $'\x89HDF' ]
install palpate-import
chroot "$root" palpate import /cloud.vtk /cloud.vdb | sed -n 1p
install palpate-view
chroot "$root" env DEBIAN_FRONTEND=noninteractive \
    apt-get -qq install -y --no-install-recommends xvfb libgl1-mesa-dri >/dev/null 2>&1
chroot "$root" palpate view /head.vdb --seconds 3 --picture /view.png | sed -n 1p
[ -s "$root/view.png" ]
install python3-palpate
chroot "$root" python3 -c '
import palpate
hand = palpate.Scene.load("/head.vdb").hand()
forces = [hand.step(0, 0, 0.06 - 2e-5 * i) for i in range(2000)]
print("python: at most", round(max(f[2] for f in forces), 2), "N")
assert max(f[2] for f in forces) > 0.1'
for package in palpate-haply palpate-doc libpalpate-dev; do install "$package"; done
[ -z "$wrong" ] || { printf '%s' "$wrong"; exit 1; }
echo "packages: all installed and tested; their sizes equal those in docs/packages.md to within 10 %"
