"""How a connection to a daemon comes about, and why it does not."""

import asyncio
import ssl

from mapperd.client.address import Place
from mapperd.client.errors import EndedError

__all__ = ["opened", "reason_of", "with_hint"]

PLAIN = frozenset({"PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE", "WRONG_VERSION_NUMBER"})
"""What TLS makes of a greeting without it, as versions of OpenSSL say it."""


async def opened(
    place: Place, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect.

    Raises:
        OSError: nobody is there.
    """
    if place.paths:
        return await asyncio.open_unix_connection(place.path)
    name = place.host if tls else None
    return await asyncio.open_connection(place.host, place.port, ssl=tls, server_hostname=name)


def reason_of(error: OSError) -> str:
    """For a person.

    Raises:
        EndedError: trying again does not mend it.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        raise EndedError(f"not trusted: {error.verify_message}", "not_trusted") from error
    if isinstance(error, ssl.SSLError) and error.reason in PLAIN:
        return "what answers there speaks no TLS: it is a plain socket, to be connected to without"
    if isinstance(error, PermissionError):
        raise EndedError(f"you may not: {error.strerror}", "no_permission") from error
    return str(error.strerror or error) or type(error).__name__


def with_hint(reason: str, place: Place, tls: ssl.SSLContext | None, *, is_greeted: bool) -> str:
    """Why a connection ended, and what may be amiss where nothing was said on it."""
    if is_greeted or tls is not None or place.paths:
        return reason
    return f"{reason} without a greeting: its socket may want TLS"
