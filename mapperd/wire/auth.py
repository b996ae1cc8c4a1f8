"""The token of a TCP socket, its proof, and limits on clients."""

import hashlib
import hmac
import ipaddress
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mapperd.errors import ConfigError

__all__ = [
    "CREDENTIALS",
    "FailureLimiter",
    "Limits",
    "TokenBucket",
    "is_proof",
    "proof_of",
    "read_token",
    "token_file",
]


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of what clients can do, wittingly or not.

    Attributes:
        clients: that follow the map, of all sockets together.
        operators: that only send requests, of all sockets together.
        newcomers: of one socket, that did not yet; one more and the oldest of them is cut.
        connects_per_s, connects_at_once: of one socket; more have to wait.
        asks_per_s, asks_at_once: of one client; more have to wait.
        hello_s: from the connection to a hello, TLS included.
    """

    clients: int = 16
    operators: int = 16
    newcomers: int = 8
    connects_per_s: float = 50.0
    connects_at_once: int = 50
    asks_per_s: float = 20.0
    asks_at_once: int = 40
    hello_s: float = 5.0


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


CREDENTIALS = ("server-token", "control-token", "stream-token")
"""Names of systemd's credential: the present one, then those of earlier versions."""

MIN_LETTERS, MAX_BYTES = 16, 1024
PURPOSE = b"mapperd-control-1 "
IPV6_SITE = 64
"""Bits: who has one address there has all of these."""


def token_file(setting: str, environ: Mapping[str, str]) -> Path | None:
    """Return the token's file: `server.token_file`, else a credential of systemd, else None."""
    if setting:
        return Path(setting)
    folder = environ.get("CREDENTIALS_DIRECTORY", "")
    paths = [Path(folder, name) for name in CREDENTIALS] if folder else []
    return next(filter(Path.exists, paths), None)


def read_token(path: Path, place: str = "$.server.token_file") -> bytes:
    """Read a token: one word of at least 16 printable letters.

    Args:
        path: of its file.
        place: in the settings, for messages.

    Raises:
        ConfigError: it cannot be read, everybody may read it, or it is no such word.
    """
    try:
        with path.open("rb") as file:
            mode = path.stat().st_mode
            token = file.read(MAX_BYTES + 1).strip()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", place) from error
    if mode & 0o007:
        raise ConfigError(f"{path}: everybody may read it or write to it; chmod 600 it", place)
    if not MIN_LETTERS <= len(token) <= MAX_BYTES or not all(33 <= c < 127 for c in token):  # noqa: PLR2004 printable ASCII
        raise ConfigError(
            f"{path}: a token is one word of {MIN_LETTERS} or more printable letters; "
            "`openssl rand -hex 32` makes one",
            place,
        )
    return token


def proof_of(token: bytes, challenge: str) -> str:
    """What only who knows the token can answer to a challenge, HMAC-SHA256 (RFC 2104) in hex."""
    return hmac.new(token, PURPOSE + challenge.encode(), hashlib.sha256).hexdigest()


def is_proof(proof: str, token: bytes, challenge: str) -> bool:
    """Whether that is the answer; takes as long for any wrong one."""
    right = proof_of(token, challenge)
    return hmac.compare_digest(proof.encode(errors="replace"), right.encode())


class FailureLimiter:
    """Makes an address that failed too often wait, whatever it says next.

    Args:
        per_s: failures forgotten a second.
        at_once: failures that are allowed after a rest.
        addresses: that are remembered; the one that failed longest ago is forgotten first.
    """

    def __init__(self, per_s: float = 0.1, at_once: int = 5, addresses: int = 1024) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._most = addresses
        self._failed: OrderedDict[str, TokenBucket] = OrderedDict()

    def __len__(self) -> int:
        return len(self._failed)

    def wait_s(self, address: str, now_s: float) -> float:
        """How long an address has to wait before it is listened to again."""
        bucket = self._failed.get(site_of(address))
        return 0.0 if bucket is None else bucket.wait_s(now_s)

    def failed(self, address: str, now_s: float) -> None:
        """Note a failure."""
        site = site_of(address)
        bucket = self._failed.pop(site, None)
        if bucket is None or bucket.is_full(now_s):
            bucket = TokenBucket(self._per_s, self._at_once)
        bucket.take(now_s)
        self._failed[site] = bucket
        if len(self._failed) > self._most:
            self._failed.popitem(last=False)


def site_of(address: str) -> str:
    """The address, or of IPv6 the network that one customer has."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv4Address):
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((parsed, IPV6_SITE), strict=False))
