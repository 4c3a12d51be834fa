#!/bin/bash
# Boots Debian's generic kernel in QEMU, without KVM, with this machine's files read-only, and runs the script GUEST inside.
# Installs QEMU and fetches the kernel at the first run. Needs Debian or Ubuntu on x86-64. TMO is the time limit in seconds.
set -e
guest=$1
work=$(cd "$(dirname "$0")/../.." && pwd)/.build/qemu
mkdir -p "$work"
as_root=; [ "$(id -u)" = 0 ] || as_root=sudo
if ! command -v qemu-system-x86_64 busybox > "$work/found" 2>&1 || [ "$(wc -l < "$work/found")" != 2 ]; then
    $as_root apt-get update -qq
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends qemu-system-x86 busybox-static
fi
if ! ls "$work"/kernel/boot/vmlinuz-* > /dev/null 2>&1; then
    package=$(apt-cache depends linux-image-amd64 linux-image-generic 2> "$work/depends" | sed -n 's/.*Depends: \(linux-image-[0-9][^ ]*\).*/\1/p' | head -1)
    (cd "$work" && apt-get download -qq "$package" 2>> "$work/depends")
    dpkg-deb -x "$work/$package"_*.deb "$work/kernel"
    rm "$work/$package"_*.deb
fi

disk=$work/initramfs
rm -rf "$disk"
mkdir -p "$disk"/{bin,modules,proc,sys,dev,new}
cp "$(command -v busybox)" "$disk/bin/busybox"
modules="virtio virtio_ring virtio_pci_legacy_dev virtio_pci_modern_dev virtio_pci fscache netfs 9pnet 9pnet_virtio 9p \
    usb-common usbcore usbip-core vhci-hcd hid usbhid hid-generic"
for module in $modules; do
    find "$work/kernel" -name "$module.ko" -exec cp {} "$disk/modules/" \;
done
cat > "$disk/init" << END
#!/bin/busybox sh
alias b=/bin/busybox
b mount -t proc p /proc; b mount -t sysfs s /sys; b mount -t devtmpfs d /dev
for pass in 1 2; do
    for module in $modules; do
        [ ! -e /modules/\$module.ko ] || b insmod /modules/\$module.ko 2> /dev/null
    done
done
b mount -t 9p -o trans=virtio,version=9p2000.L,msize=1048576,cache=loose,ro root /new || b poweroff -f
for place in proc sys dev; do b mount --move /\$place /new/\$place; done
b mkdir -p /new/dev/shm /new/dev/pts
for place in dev/shm run mnt; do b mount -t tmpfs t /new/\$place; done
b chroot /new /bin/bash $guest
b poweroff -f
END
chmod +x "$disk/init"
(cd "$disk" && find . | busybox cpio -o -H newc 2> "$work/cpio" | gzip -1 > "$work/initramfs.gz")

exec timeout "${TMO:-600}" qemu-system-x86_64 -machine q35 -accel tcg,thread=multi -cpu max -smp 2 -m 3G -nographic -no-reboot \
    -kernel "$work"/kernel/boot/vmlinuz-* -initrd "$work/initramfs.gz" -append "console=ttyS0 quiet panic=-1" \
    -virtfs local,path=/,mount_tag=root,security_model=none,readonly=on,multidevs=remap < /dev/null
