"""A copy of this machine, in which root may install and start what a page says.

Changes stay in memory: a layer over the file system takes them, and is gone at the end.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

SYSTEMD = Path("/lib/systemd/systemd")
CGROUPS = Path("/sys/fs/cgroup")
BOOT_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 30.0
POLL_S = 0.2
SECURE_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

_LAYER = """
set -eu
mount --make-rprivate /
mount -t tmpfs layer "$1"
mkdir "$1/upper" "$1/work" "$1/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" "$1/root"
root=$1/root
mount --bind "$2" "$root$2"
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t tmpfs -o mode=755 dev "$root/dev"
for name in null zero full random urandom tty; do
    touch "$root/dev/$name"; mount --bind "/dev/$name" "$root/dev/$name"
done
mkdir "$root/dev/pts" "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
ln -s /proc/self/fd "$root/dev/fd"
mount -t tmpfs -o mode=1777 shm "$root/dev/shm"
mount -t tmpfs -o mode=755 run "$root/run"
printf '#!/bin/sh\\nexec "$@"\\n' > "$root/usr/local/bin/sudo"
chmod 755 "$root/usr/local/bin/sudo"
: > "$root/etc/fstab"
mkdir -p "$root/mnt/outside"
pivot_root "$root" "$root/mnt/outside"
umount -l /mnt/outside
echo up
cat > /dev/null
"""

_BOOT = """
set -eu
umount "$1"
mount -t proc proc /proc
mount --bind /proc/sys /proc/sys
mount -o bind,remount,ro /proc/sys
umount -l /sys
mount -t sysfs sysfs /sys
if [ "$2" = 2 ]; then
    mount -t cgroup2 cgroup2 /sys/fs/cgroup
else
    mount -t tmpfs -o mode=755 cgroups /sys/fs/cgroup
    mkdir /sys/fs/cgroup/systemd
    mount -t cgroup -o none,name=systemd cgroup /sys/fs/cgroup/systemd
fi
mount -o bind,remount,ro /sys
mount --make-rshared / # systemd's own work on real machines; credentials need it
export container=test PATH=/usr/sbin:/usr/bin:/sbin:/bin
exec /lib/systemd/systemd --unit=basic.target
"""


class Machine:
    """A copy of this machine; made by `copy_of_this_machine`.

    Args:
        holder: process inside.
        folder: folder of the real file system that is part of the copy until it boots.
    """

    def __init__(self, holder: int, folder: Path) -> None:
        """Take commands for the namespaces of `holder`."""
        self._holder = holder
        self._folder = folder
        self._enter = ["nsenter", "-t", str(holder), "-m", "-p", "-i", "-u"]

    def words(self, code: str, **environment: str) -> list[str]:
        """A command that runs shell code as root, as in a new terminal."""
        kept = [f"{name}={text}" for name, text in os.environ.items() if name.startswith("PIP_")]
        given = [f"{name}={text}" for name, text in environment.items()]
        clean = ["env", "-i", f"PATH={SECURE_PATH}", "HOME=/root", *kept, *given]
        return [*self._enter, *clean, "/bin/bash", "-euc", code]

    def run(self, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run shell code as root; answer every question with yes."""
        return subprocess.run(  # noqa: S603 commands of our own pages
            self.words(code, **environment),
            input="y\n" * 10,
            capture_output=True,
            text=True,
            check=False,
        )

    @contextmanager
    def booted(self) -> Iterator[None]:
        """Run systemd as the first process, in a network with nothing but a loopback."""
        if not SYSTEMD.exists():
            pytest.skip("systemd is not installed")
        unified = (CGROUPS / "cgroup.controllers").exists()
        group = (CGROUPS if unified else CGROUPS / "systemd") / f"mapperd-test-{os.getpid()}"
        join = f"mkdir {group} && echo $$ > {group}/cgroup.procs"
        apart = "unshare --mount --pid --fork --ipc --uts --cgroup --net --kill-child"
        version = "2" if unified else "1"
        boot = shlex.join(["/bin/bash", "-c", _BOOT, "boot", str(self._folder), version])
        inside = shlex.join(["nsenter", "-t", str(self._holder), "-m"])
        with subprocess.Popen(  # noqa: S603 our own commands
            ["/bin/bash", "-euc", f"{join}; exec {inside} {apart} {boot}"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            entered = self._enter
            try:
                first = str(self._first_process(process))
                self._enter = ["nsenter", "-t", first, "-m", "-p", "-n", "-i", "-u", "-C"]
                self._wait_until_up(process)
                yield
            finally:
                self._enter = entered
                process.kill()
                process.wait(STOP_TIMEOUT_S)
                _remove_groups(group)

    @staticmethod
    def _first_process(process: subprocess.Popen[str]) -> int:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        end = time.monotonic() + BOOT_TIMEOUT_S
        while not (found := children.read_text().split()):
            assert process.poll() is None, process.stderr and process.stderr.read()
            assert time.monotonic() < end, "the copy does not boot"
            time.sleep(POLL_S)
        return int(found[0])

    def _wait_until_up(self, process: subprocess.Popen[str]) -> None:
        end = time.monotonic() + BOOT_TIMEOUT_S
        up = "systemctl is-active --quiet basic.target && ip link set lo up"
        while (done := self.run(up)).returncode != 0:
            assert process.poll() is None, process.stderr and process.stderr.read()
            assert time.monotonic() < end, done.stderr
            time.sleep(POLL_S)


def _remove_groups(group: Path) -> None:
    """Remove the control groups of ended processes."""
    for _ in range(int(STOP_TIMEOUT_S / POLL_S)):
        for folder, _names, _files in os.walk(group, topdown=False):
            with contextlib.suppress(OSError):
                Path(folder).rmdir()
        if not group.exists():
            return
        time.sleep(POLL_S)


@contextmanager
def copy_of_this_machine(folder: Path) -> Iterator[Machine]:
    """A copy of this machine; skips the test where none can be made.

    Args:
        folder: an empty one; its subfolder `home` is shared with the copy.
    """
    if os.geteuid() != 0:
        pytest.skip("only root can make a copy of the machine to install into")
    if shutil.which("unshare") is None or shutil.which("nsenter") is None:
        pytest.skip("util-linux is not installed")
    layer, home = folder / "layer", folder / "home"
    layer.mkdir()
    home.mkdir()
    apart = "unshare --mount --ipc --uts --pid --fork --kill-child"
    with subprocess.Popen(  # noqa: S603 our own commands
        [*apart.split(), "/bin/bash", "-c", _LAYER, "copy", str(layer), str(home)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        if process.stdout.readline() != "up\n":
            pytest.skip(f"no copy of the machine can be made: {process.stderr.read().strip()}")
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        try:
            yield Machine(int(children.read_text().split()[0]), home)
        finally:
            process.stdin.close()
            process.kill()
