"""How a connection to a daemon comes about, and why it does not."""

import asyncio
import ssl

from mapperd.client.address import Place
from mapperd.client.errors import EndedError

__all__ = ["opened", "reason_of"]


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
    if isinstance(error, PermissionError):
        raise EndedError(f"you may not: {error.strerror}", "no_permission") from error
    return str(error.strerror or error) or type(error).__name__
