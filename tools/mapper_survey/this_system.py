"""Where process ids and locks mean the same."""

from pathlib import Path

__all__ = ["this_system"]


def this_system() -> str:
    """Name of this machine since its last start, and within a container."""
    started = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return f"{started} {Path('/proc/self/ns/pid').readlink()}"
