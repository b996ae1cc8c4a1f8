"""Many clients whose connections break and stall at random, and who agree in the end.

    python -m studies.stream.fleet ADDRESS TOKEN --clients 50 --seconds 60

When standard input ends, which means that the map does not change any more, all are left in peace
until their maps are complete. Prints JSON: the digest of each map, how often each was connected,
and how many blocks each received.
"""

import argparse
import asyncio
import json
import random
import sys
from pathlib import Path
from typing import Any

from mapperd.client import MapClient
from mapperd.client.changes import MapChanged
from mapperd.wire.messages import Want
from studies.stream.relay import Relay

COMPLETE_TIMEOUT_S = 180.0
MAP: tuple[Want, ...] = ("map",)
CUT_EVERY_S = 12.0
STALL_EVERY_S = 15.0
MAX_STALL_S = 8.0


async def one(
    address: str, token: bytes, seconds: float, dice: int, settled: "asyncio.Task[None]"
) -> dict[str, Any]:
    """One client's life."""
    host, _, port = address.rpartition(":")
    async with Relay(host, int(port), dice=dice) as relay:
        client = MapClient(f"127.0.0.1:{relay.port}", token=token, wants=MAP, name=f"{dice}")
        async with client:
            received = {"blocks": 0}
            following = asyncio.create_task(_follow(client, received))
            mischief = random.Random(dice)  # noqa: S311 no secret
            trouble = [_cuts(relay, mischief), _stalls(relay, mischief)]
            tasks = [asyncio.create_task(each) for each in trouble]
            await asyncio.sleep(seconds)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            relay.resume()
            await asyncio.shield(settled)
            await client.complete(COMPLETE_TIMEOUT_S)
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)
            mirror = client.mirror
            digest = "" if mirror is None else mirror.digest()
            return {"digest": digest, "connects": client.link.connects, **received}


def _wait_for_release() -> None:
    """Wait for the end of standard input: from then on the map does not change."""
    sys.stdin.read()


async def _follow(client: MapClient, received: dict[str, int]) -> None:
    async for change in client.changes():
        if isinstance(change, MapChanged):
            received["blocks"] += len(change.keys)


async def _cuts(relay: Relay, mischief: random.Random) -> None:
    while True:
        await asyncio.sleep(mischief.expovariate(1 / CUT_EVERY_S))
        relay.cut()


async def _stalls(relay: Relay, mischief: random.Random) -> None:
    while True:
        await asyncio.sleep(mischief.expovariate(1 / STALL_EVERY_S))
        relay.stall()
        await asyncio.sleep(mischief.uniform(0.5, MAX_STALL_S))
        relay.resume()


async def live(args: argparse.Namespace) -> list[dict[str, Any]]:
    """All of them."""
    token = args.token.read_text().strip().encode()
    settled = asyncio.create_task(asyncio.to_thread(_wait_for_release))
    lives = [
        one(args.address, token, args.seconds, args.dice + number, settled)
        for number in range(args.clients)
    ]
    return await asyncio.gather(*lives)


def main() -> None:
    """Run the clients and report."""
    parser = argparse.ArgumentParser(prog="fleet", description=__doc__.partition("\n")[0])
    parser.add_argument("address")
    parser.add_argument("token", type=Path)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--dice", type=int, default=0)
    print(json.dumps(asyncio.run(live(parser.parse_args()))))


if __name__ == "__main__":
    main()
