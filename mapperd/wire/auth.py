"""The token of a TCP socket, its proof, and limits on clients."""

import hashlib
import hmac
import ipaddress
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mapperd.errors import ConfigError, os_reason

__all__ = [
    "CREDENTIALS",
    "FailureLimiter",
    "Limits",
    "TokenBucket",
    "is_loopback",
    "is_proof",
    "proof_of",
    "read_token",
    "token_file",
]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for clients.

    Attributes:
        clients: maximum clients that follow the map.
        operators: maximum clients that only send requests.
        newcomers: maximum connections of one listener without a hello; one more closes the oldest.
        connects_per_s, connects_at_once: connections of one listener; more have to wait.
        asks_per_s, asks_at_once: requests of one client; more have to wait.
        hello_s: time from the connection to the hello, including TLS.
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
    """A token bucket: limits a rate, and allows some at once after a pause.

    Args:
        per_s: rate in the long run.
        at_once: capacity.
    """

    def __init__(self, per_s: float, at_once: int) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._left = float(at_once)
        self._seen_s: float | None = None

    def take(self, now_s: float) -> float:
        """Take a token; return how long the caller has to wait for it, in seconds."""
        self._refill(now_s)
        self._left -= 1.0
        return max(0.0, -self._left / self._per_s)

    def wait_s(self, now_s: float) -> float:
        """Return the time until a token is available, in seconds."""
        self._refill(now_s)
        return max(0.0, (1.0 - self._left) / self._per_s)

    def is_full(self, now_s: float) -> bool:
        """Return whether the bucket is full."""
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
"""Prefix length of an IPv6 site: one client may have all addresses of a site."""


def token_file(setting: str, environ: Mapping[str, str]) -> Path | None:
    """Return the token's file: `server.token_file`, else a credential of systemd, else None.

    Raises:
        ConfigError: the folder of the credentials cannot be read.
    """
    if setting:
        return Path(setting)
    folder = environ.get("CREDENTIALS_DIRECTORY", "")
    paths = [Path(folder, name) for name in CREDENTIALS] if folder else []
    try:
        return next(filter(Path.exists, paths), None)
    except OSError as error:
        text = f"{folder}: credentials cannot be read: {os_reason(error)}"
        raise ConfigError(text, "$.server.token_file") from error


def read_token(path: Path, place: str = "$.server.token_file") -> bytes:
    """Read a token: one word of at least 16 printable characters.

    Args:
        path: of its file.
        place: of the setting, for messages.

    Raises:
        ConfigError: the file cannot be read, everybody may read it, or the token is invalid.
    """
    try:
        with path.open("rb") as file:
            mode = path.stat().st_mode
            token = file.read(MAX_BYTES + 1).strip()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {os_reason(error)}", place) from error
    if mode & 0o007:
        raise ConfigError(f"{path}: everybody may read it or write to it; chmod 600 it", place)
    if not MIN_LETTERS <= len(token) <= MAX_BYTES or not all(33 <= c < 127 for c in token):  # noqa: PLR2004 printable ASCII
        raise ConfigError(
            f"{path}: a token is one word of {MIN_LETTERS} or more printable characters; "
            "`openssl rand -hex 32` makes one",
            place,
        )
    return token


def is_loopback(host: str) -> bool:
    """Return whether only this computer reaches what listens at an address or name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def proof_of(token: bytes, challenge: str) -> str:
    """Return the proof of a token for a challenge: HMAC-SHA256 (RFC 2104) in hex."""
    return hmac.new(token, PURPOSE + challenge.encode(), hashlib.sha256).hexdigest()


def is_proof(proof: str, token: bytes, challenge: str) -> bool:
    """Return whether a proof is right, in constant time."""
    right = proof_of(token, challenge)
    return hmac.compare_digest(proof.encode(errors="replace"), right.encode())


class FailureLimiter:
    """Makes an address wait after too many failures.

    Args:
        per_s: failures forgotten a second.
        at_once: failures that are allowed at once.
        addresses: maximum addresses; the one that failed longest ago is forgotten first.
    """

    def __init__(self, per_s: float = 0.1, at_once: int = 5, addresses: int = 1024) -> None:
        self._per_s = per_s
        self._at_once = at_once
        self._most = addresses
        self._failed: OrderedDict[str, TokenBucket] = OrderedDict()

    def __len__(self) -> int:
        return len(self._failed)

    def wait_s(self, address: str, now_s: float) -> float:
        """Return how long an address has to wait, in seconds."""
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
    """Return an IPv4 address, or the network of a site for an IPv6 address."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv4Address):
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((parsed, IPV6_SITE), strict=False))
