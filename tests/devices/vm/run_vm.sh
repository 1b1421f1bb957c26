#!/usr/bin/env bash
# Tests arms on a real kernel without hardware: run_vm.sh uhid|usb|test BIN WORK MAKE_VOLUMES
# uhid: an arm and devices of USB's PID class. usb: an arm behind USB. test: an arm behind uhid, tested by the program.
#
# Starts a small machine in QEMU whose clock counts instructions, so the host's load has little effect. BIN has palpate,
# virtual_arm and vm_check. The kernel is Debian's, unpacked but not installed. Exits with 77 and the reason if a tool
# or the kernel is missing, or if the machine is not x86-64.
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
[ "$(uname -m)" = x86_64 ] || skip "the machine is not x86_64"

# Debian's small cloud kernel has uhid. Only the full kernel has USB's virtual host controller.
meta=linux-image-cloud-amd64
[ "$wire" = usb ] && meta=linux-image-amd64
mkdir -p "$work"
exec 9>"$work/lock.$wire" 8>"$work/lock.kernel"
flock 9
flock 8
package=$(apt-cache depends $meta 2>/dev/null | sed -n 's/.*Depends: \(linux-image-[0-9].*\)/\1/p' | head -1)
[ -n "$package" ] || skip "no package $meta is known: apt-get update"
kernel=$work/$package
if [ ! -d "$kernel" ]; then
    rm -rf "$kernel.new" && mkdir -p "$kernel.new"
    (cd "$kernel.new" && apt-get -qq download "$package") || skip "$package cannot be downloaded"
    dpkg-deb -x "$kernel.new"/*.deb "$kernel.new" && rm "$kernel.new"/*.deb
    mv "$kernel.new" "$kernel"
fi
exec 8>&-

root=$work/root.$wire
rm -rf "$root" && mkdir -p "$root"/{bin,mod,tmp}
cp "$(command -v busybox)" "$root/bin/busybox"
ln -s busybox "$root/bin/sh"
install -m 755 "$here/init" "$root/init"
cp "$here/virtual.json" "$root/"
for module in hid hid-generic uhid usb-common usbcore usbip-core vhci-hcd usbhid; do
    find "$kernel" -path '*/lib/modules/*' \( -name "$module.ko" -o -name "$module.ko.xz" \) -exec cp {} "$root/mod/" \;
done
find "$root/mod" -name '*.xz' -exec unxz {} +  # Debian 13 compresses modules.
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
# The host determines how long the run takes, but not the machine's time. If permitted, QEMU has priority. Both of
# QEMU's threads share a core, and the thread that computes must not preempt the main thread, which runs the timers:
# each millisecond of a timer's delay on the host would be one in the machine.
core=$((1 % $(nproc)))
[ "$wire" = test ] && core=0
pin=(taskset -c $core)
chrt -f 1 "${pin[@]}" true 2>/dev/null || pin=()
identity=$work/pid.$wire
rm -f "$identity"
{
    for ((i = 0; i < 100; ++i)); do
        # Waits for the second and third thread: threads that start later inherit the priority.
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
