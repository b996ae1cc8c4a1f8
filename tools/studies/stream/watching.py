"""What a client knew when: a program that follows a map and writes down every change.

    python -m studies.stream.watching ADDRESS TOKEN LOG [--until-complete] [--everything]

SIGTERM ends it, or, with `--until-complete`, makes it wait until nothing is left to be sent.
"""

import argparse
import asyncio
import signal
import time
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.client import MapClient
from mapperd.client.changes import LinkChanged, MapChanged
from mapperd.client.mirror import MapMirror
from mapperd.wire.messages import WANTS, PoseMessage, Want

__all__ = ["WatchLog", "read_log"]

COMPLETE_TIMEOUT_S = 240.0
MAP_AND_POSE: tuple[Want, ...] = ("map", "pose")


@dataclass(slots=True)
class WatchLog:
    """Changes in their order, host clock.

    Attributes:
        times_ns: (N,) when a block was received.
        keys: (N, 3) which.
        digests: (N,) of its content.
        stamps_ns: (N,) when it was so, by the daemon.
        pose_times_ns, poses_m: (M,), (M, 3) reported poses of the vehicle.
        traffic: (K, 2) time in ns and bytes received until then.
        connects: how often it was connected.
        digest: of the whole mirror at the end.
        complete: the mirror was complete then.
    """

    times_ns: list[int] = field(default_factory=list)
    keys: list[tuple[int, int, int]] = field(default_factory=list)
    digests: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    pose_times_ns: list[int] = field(default_factory=list)
    poses_m: list[tuple[float, float, float]] = field(default_factory=list)
    traffic: list[tuple[int, int]] = field(default_factory=list)
    connects: int = 0
    digest: str = ""
    complete: bool = False

    def note(self, keys: NDArray[np.int32], stamp_ns: int, mirror: MapMirror) -> None:
        """Blocks are others now."""
        now_ns = time.time_ns()
        for key, cells in zip(keys.tolist(), mirror.cells_of(keys), strict=True):
            self.times_ns.append(now_ns)
            self.keys.append((key[0], key[1], key[2]))
            self.stamps_ns.append(stamp_ns)
            self.digests.append(zlib.crc32(cells.tobytes()))

    def save(self, path: Path) -> None:
        """Into a file of numpy's."""
        np.savez(
            path,
            times_ns=np.array(self.times_ns, np.int64),
            stamps_ns=np.array(self.stamps_ns, np.int64),
            keys=np.array(self.keys, np.int32).reshape(-1, 3),
            digests=np.array(self.digests, np.int64),
            pose_times_ns=np.array(self.pose_times_ns, np.int64),
            poses_m=np.array(self.poses_m).reshape(-1, 3),
            traffic=np.array(self.traffic, np.int64).reshape(-1, 2),
            facts=np.array([self.digest, str(self.connects), str(self.complete)]),
        )


def read_log(path: Path) -> dict[str, NDArray[np.generic]]:
    """What `WatchLog.save` wrote, by name."""
    with np.load(path) as held:
        return dict(held)


async def watch(args: argparse.Namespace, log: WatchLog) -> None:
    """Follow the map until SIGTERM, and then perhaps until it is complete."""
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    token = args.token.read_text().strip().encode()
    wants = tuple(want for want in WANTS if want != "image") if args.everything else MAP_AND_POSE
    async with MapClient(args.address, token=token, wants=wants, name="study") as client:
        following = asyncio.create_task(_follow(client, log, written=not args.everything))
        await stop.wait()
        if args.until_complete:
            await client.complete(COMPLETE_TIMEOUT_S)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        if client.mirror is not None:
            log.digest = client.mirror.digest()
            log.complete = client.mirror.complete is not None


async def _follow(client: MapClient, log: WatchLog, *, written: bool) -> None:
    async for change in client.changes():
        if not written:
            continue
        match change:
            case MapChanged(keys=keys, stamp_ns=stamp_ns) if client.mirror is not None:
                log.note(keys, stamp_ns, client.mirror)
            case PoseMessage(position_m=place):
                log.pose_times_ns.append(time.time_ns())
                log.poses_m.append(place)
            case LinkChanged(link=link):
                log.connects = link.connects
        log.traffic.append((time.time_ns(), client.link.bytes))


def main() -> None:
    """Follow, and write down."""
    parser = argparse.ArgumentParser(prog="watching", description=__doc__.partition("\n")[0])
    parser.add_argument("address")
    parser.add_argument("token", type=Path)
    parser.add_argument("log", type=Path)
    parser.add_argument("--until-complete", action="store_true")
    parser.add_argument("--everything", action="store_true", help="receive all but images")
    args = parser.parse_args()
    log = WatchLog()
    try:
        asyncio.run(watch(args, log))
    finally:
        log.save(args.log)


if __name__ == "__main__":
    main()
