"""What one client may take of the daemon, and how fast."""

from dataclasses import dataclass

__all__ = ["Limits", "TokenBucket"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of what clients can do, wittingly or not.

    Attributes:
        clients: of all sockets together, that said hello.
        newcomers: of one socket, that did not yet; one more and the oldest of them is cut.
        connects_per_s, connects_at_once: of one socket; more have to wait.
        line_bytes: longest request.
        asks_per_s, asks_at_once: of one client; more have to wait.
        malformed: requests that make no sense before a client is cut.
        hello_s: from the connection to a hello, TLS included.
        line_s: from the first byte of a request to its end.
        idle_s: without a request; who follows the events may be silent.
        write_s: to take an answer.
    """

    clients: int = 16
    newcomers: int = 8
    connects_per_s: float = 50.0
    connects_at_once: int = 50
    line_bytes: int = 65536
    asks_per_s: float = 20.0
    asks_at_once: int = 40
    malformed: int = 10
    hello_s: float = 5.0
    line_s: float = 10.0
    idle_s: float = 300.0
    write_s: float = 10.0


class TokenBucket:
    """Lets so many a second through, and some at once after a rest.

    Args:
        per_s: in the long run.
        at_once: after a rest.
    """

    def __init__(self, per_s: float, at_once: int) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._left = float(at_once)
        self._seen_s: float | None = None

    def take(self, now_s: float) -> float:
        """Let one through; returns how long it has to wait, in seconds."""
        self._refill(now_s)
        self._left -= 1.0
        return max(0.0, -self._left / self._per_s)

    def wait_s(self, now_s: float) -> float:
        """How long one would have to wait, if it came now."""
        self._refill(now_s)
        return max(0.0, (1.0 - self._left) / self._per_s)

    def is_full(self, now_s: float) -> bool:
        """Whether nothing is remembered any more."""
        self._refill(now_s)
        return self._left >= self._at_once

    def _refill(self, now_s: float) -> None:
        passed_s = 0.0 if self._seen_s is None else max(0.0, now_s - self._seen_s)
        self._seen_s = now_s
        self._left = min(self._at_once, self._left + passed_s * self._per_s)
