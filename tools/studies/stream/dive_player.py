"""A capture as a dive that happens now: a sonar on TCP, and its vehicle's odometry on UDP.

Both links of the capture are played side by side in the recorded time, the odometry's stamps moved
to now. When the sonar begins the recording again, so does the odometry, with a new reset counter.
"""

import argparse
import asyncio
import socket
import time
from pathlib import Path

import msgpack

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, open_recording
from oculus_driver.virtual_sonar.playback import PlaybackSonar

__all__ = ["DivePlayer", "Record", "read_odometry"]

Record = tuple[int, dict[str, object]]

BETWEEN_NS = 100_000_000
"""A ping later than this after the last one of a round is the first of another."""


def read_odometry(capture: Path) -> tuple[int, int, list[Record]]:
    """The sonar's first and last stamps, and the odometry's records with theirs, in nanoseconds."""
    first_ns: int | None = None
    last_ns = 0
    records: list[Record] = []
    for chunk in open_recording(capture):
        if chunk.arrival_ns is None:
            continue
        if chunk.encoding == OCULUS:
            first_ns = chunk.arrival_ns if first_ns is None else first_ns
            last_ns = chunk.arrival_ns
        elif chunk.encoding == ODOMETRY_NATIVE:
            records.append((chunk.arrival_ns, msgpack.unpackb(chunk.data)))
    if first_ns is None or not records:
        raise SystemExit(f"{capture}: holds no sonar data, or no odometry")
    return first_ns, last_ns, records


class DivePlayer:
    """Plays one capture, again and again.

    Args:
        capture: a recording of a sonar and of native odometry records.
        host, port: where the sonar listens.
        odometry: where records are sent.
        loops: how often; None for ever.
    """

    def __init__(
        self,
        capture: Path,
        host: str,
        port: int,
        odometry: tuple[str, int],
        loops: int | None = None,
    ) -> None:
        self._first_ns, self._last_ns, self._records = read_odometry(capture)
        self._to = odometry
        self._begun = asyncio.Event()
        self._began_ns: int | None = None
        self._round = 0
        self._sonar = PlaybackSonar(
            str(capture), host=host, port=port, loops=loops, on_ping=self._note
        )

    async def run(self) -> None:
        """Play until cancelled."""
        async with self._sonar:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                while True:
                    await self._begun.wait()
                    self._begun.clear()
                    await self._send(out)

    def _note(self, _ping_id: int, _: bool) -> None:  # noqa: FBT001 the driver's own signature
        """A ping is sent; the first one of a round sets the time."""
        now_ns = time.time_ns()
        round_ns = self._last_ns - self._first_ns
        if self._began_ns is None or now_ns - self._began_ns > round_ns + BETWEEN_NS:
            self._began_ns = now_ns
            self._round += 1
            self._begun.set()

    async def _send(self, out: socket.socket) -> None:
        """One round of the odometry; ends early where the sonar begins another."""
        assert self._began_ns is not None  # noqa: S101 a round has begun
        moved_ns = self._began_ns - self._first_ns
        for arrival_ns, record in self._records:
            late_s = (arrival_ns + moved_ns - time.time_ns()) / 1e9
            if late_s > 0:
                await asyncio.sleep(late_s)
            if self._begun.is_set():
                return
            stamp = record["t"]
            assert isinstance(stamp, int)  # noqa: S101 the simulator's own record
            moved = {**record, "t": stamp + moved_ns, "rst": self._round}
            out.sendto(msgpack.packb(moved), self._to)


def main() -> None:
    """Play until killed."""
    parser = argparse.ArgumentParser(prog="dive-player", description=__doc__.partition("\n")[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--sonar", default="127.0.0.1:52100", help="where the sonar listens")
    parser.add_argument("--odometry", default="127.0.0.1:52200", help="where records are sent")
    parser.add_argument("--loops", type=int, default=0, help="0 plays for ever")
    args = parser.parse_args()
    host, _, port = args.sonar.rpartition(":")
    to_host, _, to_port = args.odometry.rpartition(":")
    player = DivePlayer(args.capture, host, int(port), (to_host, int(to_port)), args.loops or None)
    asyncio.run(player.run())


if __name__ == "__main__":
    main()
