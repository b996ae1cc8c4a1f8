"""Sockets that the service manager opened for us, by the protocol of sd_listen_fds(3)."""

import os
import socket
from collections.abc import MutableMapping

__all__ = ["inherited_sockets"]

FIRST = 3
MOST = 16


def inherited_sockets(environ: MutableMapping[str, str], pid: int) -> dict[str, socket.socket]:
    """Sockets by the name that the unit gives them; they are ours from now on.

    The variables are removed, so that no child takes them for its own.

    Args:
        environ: `LISTEN_PID`, `LISTEN_FDS`, `LISTEN_FDNAMES`.
        pid: of this process; sockets for another one are not touched.
    """
    meant_for = environ.pop("LISTEN_PID", "")
    number = environ.pop("LISTEN_FDS", "")
    names = environ.pop("LISTEN_FDNAMES", "").split(":")
    if meant_for != str(pid) or not number.isdecimal() or int(number) > MOST:
        return {}
    found: dict[str, socket.socket] = {}
    for i in range(int(number)):
        os.set_inheritable(FIRST + i, False)  # noqa: FBT003 its only argument
        name = names[i] if i < len(names) and names[i] else f"socket{i}"
        found[name] = socket.socket(fileno=FIRST + i)
    return found
