#!/usr/bin/env bash
# Arms on a real kernel with no hardware: run_vm.sh uhid|usb BIN WORK MAKE_VOLUMES
#
# A small machine in QEMU whose clock counts instructions, so that it is the same whatever else the host
# does. BIN: the folder of palpate, virtual_arm, vm_check. Kernel: Debian's, unpacked, not installed.
# Exit 77, with the reason, where QEMU or the kernel cannot be had.
set -euo pipefail
wire=$1 bin=$2 work=$3 volumes=$4
here=$(cd "$(dirname "$0")" && pwd)
skip() {
    echo "skipped: $*" >&2
    exit 77
}
for tool in qemu-system-x86_64 busybox cpio dpkg-deb; do
    command -v $tool >/dev/null || skip "no $tool: .ci/install test"
done
[ "$(uname -m)" = x86_64 ] || skip "the machine is no x86_64"

# uhid is in the small kernel of clouds, USB's virtual host controller in the full one.
meta=linux-image-cloud-amd64
[ "$wire" = usb ] && meta=linux-image-amd64
mkdir -p "$work"
exec 9>"$work/lock.$wire"
flock 9
package=$(apt-cache depends $meta 2>/dev/null | sed -n 's/.*Depends: \(linux-image-[0-9].*\)/\1/p' | head -1)
[ -n "$package" ] || skip "no package $meta is known: apt-get update"
kernel=$work/$package
if [ ! -d "$kernel" ]; then
    rm -rf "$kernel.new" && mkdir -p "$kernel.new"
    (cd "$kernel.new" && apt-get -qq download "$package") || skip "$package cannot be had"
    dpkg-deb -x "$kernel.new"/*.deb "$kernel.new" && rm "$kernel.new"/*.deb
    mv "$kernel.new" "$kernel"
fi

root=$work/root.$wire
rm -rf "$root" && mkdir -p "$root"/{bin,mod,tmp}
cp "$(command -v busybox)" "$root/bin/busybox"
ln -s busybox "$root/bin/sh"
install -m 755 "$here/init" "$root/init"
cp "$here/virtual.json" "$root/"
for module in hid hid-generic uhid usb-common usbcore usbip-core vhci-hcd usbhid; do
    find "$kernel/lib/modules" -name "$module.ko" -exec cp {} "$root/mod/" \;
done
programs=("$bin/vm_check" "$bin/virtual_arm" "$bin/palpate")
cp "${programs[@]}" "$root/bin/"
strip "$root/bin/vm_check" "$root/bin/virtual_arm" "$root/bin/palpate"
ldd "${programs[@]}" | grep -o '/[^ :]*\.so[^ :]*' | sort -u | while read -r library; do
    mkdir -p "$root$(dirname "$library")"
    cp -Ln "$library" "$root$library"
done
"$volumes" "$root/tmp" && mv "$root/tmp/ball.vdb" "$root/"
(cd "$root" && find . | cpio -o -H newc --quiet) >"$work/initrd.$wire"
rm -rf "$root"

log=$work/$wire.log
# Its time is its own; how long that takes is ours: before what else computes, where that is permitted.
# One core for both of its threads, and on it its main thread, which runs the machine's timers, is never
# put aside for the other: the machine computes on while a timer is on its way to it, and where that
# takes milliseconds of the host's, it takes as many of the machine's.
core=0
[ "$wire" = usb ] && core=$((1 % $(nproc)))
pin=(taskset -c $core)
chrt -f 1 "${pin[@]}" true 2>/dev/null || pin=()
identity=$work/pid.$wire
rm -f "$identity"
{
    for ((i = 0; i < 100; ++i)); do
        # Not before the other thread is there (and a third that waits): it would be above as well.
        [ "$(ls "/proc/$(cat "$identity")/task" | wc -l)" -lt 3 ] || break
        sleep 0.1
    done
    chrt -f -p 1 "$(cat "$identity")"
} >/dev/null 2>&1 9>&- &
nice -n -15 timeout 1200 "${pin[@]}" qemu-system-x86_64 -accel tcg -cpu max -smp 1 \
    -icount shift=1,sleep=off -rtc clock=vm -m 768 -pidfile "$identity" \
    -nodefaults -display none -serial stdio -no-reboot -kernel "$kernel"/boot/vmlinuz-* \
    -initrd "$work/initrd.$wire" -append "console=ttyS0 quiet panic=-1 wire=$wire" \
    </dev/null | tr -d '\r' | tee "$log" || true
grep -q '^VM_STATUS=0$' "$log" && ! grep -q '^FAIL' "$log"
