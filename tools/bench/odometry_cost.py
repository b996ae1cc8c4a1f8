"""What odometry costs: share of one core for 400 Hz of records and the poses of 40 Hz of pings.

For each format the bytes of a minute are made beforehand. What is timed is the whole way: decode,
carry the clock over, fuse, and ask for the pose and the motion at each ping's time. Processor time,
the least of three runs. Prints the table; --write puts it into docs/reports/odometry.md.

Usage: python -m bench odometry-cost [--seconds N] [--write]
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from studies.report import PAGES, write_section

from mapperd.config.odometry import FormatName, OdometryFusionConfig, OdometrySourceConfig
from mapperd.config.tree import Config
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.native import NativeRecord, encode_native, encode_native_serial

RECORDS_HZ, PINGS_HZ = 400, 40
TARGET = 0.10
START_NS = 1_700_000_000 * 10**9
DELAY_NS = 20_000_000
RUNS = 3

Encode = Callable[[int, float], bytes]


def _native(t_ns: int, t_s: float) -> NativeRecord:
    turned = 0.2 * t_s
    return NativeRecord(
        v=1,
        clk="boot",
        t=t_ns - START_NS + 10**12,
        w="ned",
        b="frd",
        p=(5 * math.sin(turned), 5 * (1 - math.cos(turned)), 3.0),
        q=(math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)),
        u=(1.0, 0.0, 0.0),
        r=(0.0, 0.0, 0.2),
    )


def _json_line(t_ns: int, t_s: float) -> bytes:
    record = _native(t_ns, t_s)
    fields = {key: value for key in record.__struct_fields__ if (value := getattr(record, key))}
    return json.dumps(fields).encode() + b"\n"


def _autopilot() -> Encode:
    from pymavlink.dialects.v20 import common  # noqa: PLC0415 an extra

    codec: Any = common.MAVLink(None, srcSystem=1, srcComponent=1)

    def encode(t_ns: int, t_s: float) -> bytes:
        """Position and attitude in turns: each at half the rate."""
        boot_ms, turned = (t_ns - START_NS) // 1_000_000 + 5000, 0.2 * t_s
        x, y = 5 * math.sin(turned), 5 * (1 - math.cos(turned))
        place = common.MAVLink_local_position_ned_message(boot_ms, x, y, 3.0, 1.0, 0.0, 0.0)
        yaw = math.remainder(turned, math.tau)
        attitude = common.MAVLink_attitude_message(boot_ms, 0.0, 0.0, yaw, 0.0, 0.0, 0.2)
        message = place if round(t_s * RECORDS_HZ) % 2 else attitude
        return bytes(message.pack(codec))

    return encode


def _dvl(t_ns: int, t_s: float) -> bytes:  # noqa: ARG001 it drives straight on
    """Velocities; the attitude of this dive comes from a native record every tenth time."""
    return (
        json.dumps(
            {
                "type": "velocity",
                "format": "json_v3.1",
                "time": 2.5,
                "vx": 1.0,
                "vy": 0.0,
                "vz": 0.0,
                "fom": 0.01,
                "covariance": [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]],
                "altitude": 2.5,
                "transducers": [{"id": k, "velocity": 0.1, "distance": 2.6} for k in range(4)],
                "velocity_valid": True,
                "status": 0,
                "time_of_validity": t_ns // 1000,
                "time_of_transmission": t_ns // 1000,
            }
        ).encode()
        + b"\r\n"
    )


def _heading(t_ns: int, t_s: float) -> bytes:
    """Fixes and headings in turns."""
    if round(t_s * RECORDS_HZ) % 2:
        body = f"PRDID,0.00,0.00,{math.degrees(0.2 * t_s) % 360:.2f}"
    else:
        of_day = time.gmtime(t_ns // 10**9)
        clock = f"{time.strftime('%H%M', of_day)}{of_day.tm_sec + t_ns % 10**9 / 1e9:07.4f}"
        body = f"GPGGA,{clock},6000.0000,N,00500.0000,E,1,08,0.9,0.0,M,0.0,M,,"
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def formats() -> dict[FormatName, Encode]:
    """Map each format to the bytes that its sender sends at a time."""
    return {
        "native": lambda t_ns, t_s: encode_native(_native(t_ns, t_s)),
        "native_json": _json_line,
        "native_serial": lambda t_ns, t_s: encode_native_serial(_native(t_ns, t_s)),
        "mavlink": _autopilot(),
        "water_linked_json": _dvl,
        "nmea": _heading,
    }


def config_of(name: FormatName) -> Config:
    """The source, and beside a DVL one of attitude."""
    link = "udp://127.0.0.1:52200" if name == "native" else "tcp://127.0.0.1:52200"
    sources = [OdometrySourceConfig(name="vehicle", format=name, link=link)]
    if name == "water_linked_json":
        sources.append(OdometrySourceConfig(name="ahrs", link="udp://127.0.0.1:52201"))
    return Config(odometry=OdometryFusionConfig(sources=tuple(sources)))


def pieces(name: FormatName, encode: Encode, seconds: float) -> Iterator[tuple[str, bytes, int]]:
    """Link, bytes, arrival."""
    for k in range(round(seconds * RECORDS_HZ)):
        t_s = k / RECORDS_HZ
        t_ns = START_NS + round(t_s * 1e9)
        if name == "water_linked_json" and k % 10 == 0:
            attitude = NativeRecord(
                v=1, clk="unix", t=t_ns, w="enu", b="flu", q=_native(t_ns, t_s).q
            )
            yield "ahrs", encode_native(attitude), t_ns + 1_000_000
        yield "vehicle", encode(t_ns, t_s), t_ns + 1_000_000


def spent_s(config: Config, chunks: list[tuple[str, bytes, int]]) -> tuple[float, int, int]:
    """Processor time; pings asked, and those that got a pose."""
    bridge = OdometryBridge(config)
    each = RECORDS_HZ // PINGS_HZ
    asked = found = 0
    began_s = time.process_time()
    for k, (link, data, arrival_ns) in enumerate(chunks):
        bridge.feed(link, data, arrival_ns)
        if k % each == 0:
            t_ns = arrival_ns - DELAY_NS
            bridge.fusion.ready(t_ns)
            asked += 1
            found += isinstance(bridge.fusion.at(t_ns), FusedPose)
    return time.process_time() - began_s, asked, found


def table(seconds: float) -> str:
    """Markdown.

    Raises:
        ValueError: pings had no pose, so that less was done than is reported.
    """
    lines = ["| format | of one core | a record, with its part of the poses |", "|---|---:|---:|"]
    for name, encode in formats().items():
        chunks = list(pieces(name, encode, seconds))
        runs = [spent_s(config_of(name), chunks) for _ in range(RUNS)]
        _, asked, found = runs[0]
        if found < 0.95 * asked:
            raise ValueError(f"{name}: {found} of {asked} pings had a pose")
        min_s = min(run[0] for run in runs)
        share, each_us = min_s / seconds, 1e6 * min_s / len(chunks)
        lines.append(f"| `{name}` | {100 * share:.1f} % | {each_us:.0f} µs |")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of odometry a format")
    parser.add_argument("--write", action="store_true", help="put the table into its page")
    args = parser.parse_args()
    text = table(args.seconds)
    print(text)
    if args.write:
        write_section(PAGES["odometry"], "odometry cost", text, "python -m bench odometry-cost")


if __name__ == "__main__":
    main()
