"""TLS to a plain server, and plain bytes to a TLS server, give an error that names the cause."""

import asyncio
import ssl
from pathlib import Path

import pytest

from mapperd.client import LinkChanged, MapClient
from mapperd.wire.auth import Limits
from tests.mapperd.server.watched import bed_of
from tests.support.waiting import run

pytestmark = pytest.mark.net


@pytest.mark.parametrize(
    ("listener", "speaks_tls", "hint"),
    [
        ("open", True, "TLS"),
        ("tls", False, "TLS"),
    ],
)
def test_the_wrong_door_is_reported(
    short: Path,
    tls: tuple[ssl.SSLContext, ssl.SSLContext],
    listener: str,
    speaks_tls: bool,  # noqa: FBT001 of a parameter set
    hint: str,
) -> None:
    reasons: list[str] = []

    async def work() -> None:
        async with bed_of(short, tls[0], Limits(hello_s=0.2)) as bed:
            host, port = bed.listeners[listener].socket.getsockname()
            trusted = tls[1] if speaks_tls else None
            async with MapClient(f"{host}:{port}", tls=trusted) as client:
                async for change in client.changes():
                    if isinstance(change, LinkChanged) and change.link.state == "waiting":
                        reasons.append(change.link.reason)
                        break
            await asyncio.sleep(0)

    run(work())
    assert len(reasons) == 1
    assert hint in reasons[0]


def test_no_hint_where_the_daemon_reported_something(short: Path) -> None:
    async def work() -> None:
        async with bed_of(short) as bed:
            host, port = bed.listeners["open"].socket.getsockname()
            async with MapClient(f"{host}:{port}") as client:
                await until(client, "connected")
                (connection,) = bed.server._clients
                connection.abort()
                await until(client, "waiting")
                assert "TLS" not in client.link.reason

    run(work())


async def until(client: MapClient, state: str) -> None:
    while client.link.state != state:  # noqa: ASYNC110 of another task
        await asyncio.sleep(0)
