#!/usr/bin/env bash
# Runs ./demo.sh on an empty Debian: debian_test.sh RELEASE [--test]. RELEASE is bookworm or trixie. Debootstrap
# makes a root of that release; there an ordinary user with sudo runs ./demo.sh on the commit that is checked out, then
# with --test also ./test.sh. Prints minutes, processor minutes and megabytes. Exits with 77 without root or
# debootstrap; fails without the network. For ./test.sh --long.
set -euo pipefail
[ "$(id -u)" -eq 0 ] && command -v debootstrap >/dev/null || { echo "debian: needs root and debootstrap"; exit 77; }
release=${1:?RELEASE is missing: bookworm or trixie}
tree=$(cd "$(dirname "$0")/.." && pwd)
place=$(mktemp -d)
root=$place/root
# No file system with data is mounted below the folder, so removing it is safe.
cleanup() {
    umount "$root/dev/shm" "$root/dev/pts" "$root/sys" "$root/proc" 2>/dev/null || true
    rm -rf --one-file-system "$place"
}
trap cleanup EXIT
megabytes() { du -sm --one-file-system "$root" | cut -f1; }
quietly() { "$@" >>"$place/log" 2>&1 || { tail -40 "$place/log"; exit 1; }; }

# Uses the mirror from which this machine gets its packages.
from=$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | awk '!/security/ && !n++')
quietly debootstrap --variant=minbase --include=sudo,ca-certificates "$release" "$root" "$from"
cp -rL /etc/apt/apt.conf.d/. "$root/etc/apt/apt.conf.d/"
cp -L /etc/resolv.conf "$root/etc/" 2>/dev/null || true
mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount -t devpts devpts "$root/dev/pts"
mount -t tmpfs tmpfs "$root/dev/shm"
chroot "$root" useradd --create-home --shell /bin/bash ada
echo 'ada ALL=(ALL) NOPASSWD: ALL' >"$root/etc/sudoers.d/ada"
mkdir "$root/home/ada/palpate"
git -C "$tree" archive HEAD | tar -x -C "$root/home/ada/palpate"
chroot "$root" chown -R ada: /home/ada
. "$root/etc/os-release"
echo "empty $PRETTY_NAME: $(megabytes) MB"

# as_user COMMAND: runs COMMAND in the checkout. Prints its minutes, its processor minutes and its disk space.
as_user() {
    local before since=$SECONDS status=0
    before=$(megabytes)
    TIMEFORMAT='%U %S'
    { time chroot "$root" su - ada -c "cd palpate && $1" >"$place/said" 2>&1 || status=$?; } 2>"$place/cpu"
    tail -3 "$place/said"
    [ $status -eq 0 ] || { tail -60 "$place/said"; echo "debian: $1 failed on $PRETTY_NAME"; exit 1; }
    echo "$1 on $PRETTY_NAME: $(((SECONDS - since + 30) / 60)) minutes," \
         "$(awk '{ printf "%.1f", ($1 + $2) / 60 }' "$place/cpu") of the processor, $(($(megabytes) - before)) MB"
}
as_user ./demo.sh
[ "${2:-}" != --test ] || as_user "./test.sh${PALPATE_DATA:+ --data $PALPATE_DATA}"
