"""Free ports, and resources of this process."""

import contextlib
import os
import socket
from pathlib import Path


def free_ports(*kinds: int) -> list[int]:
    """Return different ports of 127.0.0.1 that nothing uses; each of `kinds` is UDP or TCP."""
    with contextlib.ExitStack() as stack:
        probes = [stack.enter_context(socket.socket(socket.AF_INET, kind)) for kind in kinds]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]


def free_port() -> int:
    """Return a UDP port of 127.0.0.1 that nothing uses."""
    return free_ports(socket.SOCK_DGRAM)[0]


def free_tcp_port() -> int:
    """Return a TCP port of 127.0.0.1 that nothing uses."""
    return free_ports(socket.SOCK_STREAM)[0]


def resident_bytes() -> int:
    """Return the memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def open_files() -> int:
    """Return the number of file descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))
