"""A bad link, as a rule: what becomes of each packet that is put into it."""

import contextlib
import fcntl
import heapq
import os
import random
import secrets
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

__all__ = [
    "CLIENT",
    "SERVER",
    "LinkShape",
    "NotPermittedError",
    "ShapedLink",
    "Tether",
    "joined_hosts",
]


@dataclass(frozen=True, slots=True)
class LinkShape:
    """One direction of a link.

    Attributes:
        bits_per_s: that go through.
        delay_s: of every packet, after its turn.
        loss: share of packets that vanish.
        queue_bytes: that wait for their turn; what comes on top vanishes too.
    """

    bits_per_s: float = 256e3
    delay_s: float = 0.3
    loss: float = 0.05
    queue_bytes: int = 64 << 10


class ShapedLink:
    """Decides, for packets in the order of their times, when they come out.

    Args:
        shape: of the link.
        dice: seeds the losses.

    Attributes:
        lost, overflowed: packets that vanished by chance, and for want of room.
        bytes: that came through.
    """

    def __init__(self, shape: LinkShape, dice: int) -> None:
        self.lost = self.overflowed = self.bytes = 0
        self._shape = shape
        self._random = random.Random(dice)  # noqa: S311 no secret
        self._free_s = 0.0

    def arrives_s(self, now_s: float, size: int) -> float | None:
        """When a packet that comes now is at the other end; None for never."""
        shape = self._shape
        waiting_s = max(self._free_s - now_s, 0.0)
        if waiting_s * shape.bits_per_s / 8 + size > shape.queue_bytes:
            self.overflowed += 1
            return None
        self._free_s = now_s + waiting_s + size * 8 / shape.bits_per_s
        if self._random.random() < shape.loss:
            self.lost += 1
            return None
        self.bytes += size
        return self._free_s + shape.delay_s


SERVER, CLIENT = "10.99.0.1", "10.99.0.2"

TUNSETIFF = 0x400454CA
IFF_TUN_NO_PI = 0x1001
MTU = 1500


class NotPermittedError(Exception):
    """This machine, or this user, may not make hosts; the text names what failed."""


class Tether:
    """Carries packets between two tunnels until closed.

    Args:
        server, client: descriptors of the tunnels.
        down, up: the link from the server to the client, and back.

    Attributes:
        down, up: as made; their counters count what was lost.
    """

    def __init__(self, server: int, client: int, shape: LinkShape, dice: int) -> None:
        self.down = ShapedLink(shape, dice)
        self.up = ShapedLink(shape, dice + 1)
        self._ways = {server: (self.down, client), client: (self.up, server)}
        self._under_way: list[tuple[float, int, int, bytes]] = []
        self._number = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Carry nothing any more."""
        self._stop.set()
        self._thread.join()

    def _carry(self) -> None:
        while not self._stop.is_set():
            due_s = self._under_way[0][0] - time.monotonic() if self._under_way else 0.05
            ready, _, _ = select.select(list(self._ways), [], [], min(max(due_s, 0.0), 0.05))
            for tunnel in ready:
                packet = os.read(tunnel, 65536)
                link, to = self._ways[tunnel]
                arrives_s = link.arrives_s(time.monotonic(), len(packet))
                if arrives_s is not None:
                    self._number += 1
                    heapq.heappush(self._under_way, (arrives_s, self._number, to, packet))
            while self._under_way and self._under_way[0][0] <= time.monotonic():
                _, _, to, packet = heapq.heappop(self._under_way)
                with contextlib.suppress(OSError):  # the host is just going
                    os.write(to, packet)


@contextlib.contextmanager
def joined_hosts(shape: LinkShape, dice: int) -> Iterator[tuple[str, str, Tether]]:
    """Names of the namespaces of the server and the client, and the link, as long as this lasts.

    Raises:
        NotPermittedError: they cannot be made here.
    """
    mark = secrets.token_hex(3)
    names = [f"mapperd-{mark}-{side}" for side in ("server", "client")]
    with contextlib.ExitStack() as stack:
        tunnels = []
        for name, address in zip(names, (SERVER, CLIENT), strict=True):
            _ip("netns", "add", name)
            stack.callback(_ip, "netns", "del", name)
            device = f"t{mark}{name[-6]}"
            tunnels.append(_tunnel(device))
            stack.callback(os.close, tunnels[-1])
            _ip("link", "set", device, "netns", name)
            _ip("-n", name, "addr", "add", f"{address}/30", "dev", device)
            _ip("-n", name, "link", "set", device, "mtu", str(MTU), "up")
            _ip("-n", name, "link", "set", "lo", "up")
        tether = Tether(tunnels[0], tunnels[1], shape, dice)
        stack.callback(tether.close)
        yield names[0], names[1], tether


def _tunnel(name: str) -> int:
    try:
        tunnel = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(tunnel, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN_NO_PI))
    except OSError as error:
        raise NotPermittedError(f"/dev/net/tun: {error}") from error
    return tunnel


def _ip(*words: str) -> None:
    program = shutil.which("ip", path="/usr/sbin:/sbin:/usr/bin:/bin")
    if program is None:
        raise NotPermittedError("no `ip` here (package iproute2)")
    done = subprocess.run([program, *words], capture_output=True, text=True, check=False)  # noqa: S603
    if done.returncode != 0:
        raise NotPermittedError(f"ip {' '.join(words)}: {done.stderr.strip()}")
