"""`mapperd doctor`: each failing layer is named with a remedy."""

import json
import socket
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from mapperd.cli.mapperd import main
from mapperd.config.odometry import parse_address
from mapperd.daemon.doctor import LAYERS, LinkEvidence, judge_link
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.links import LinkPhase, OdometryLinkStatus


def status(
    phase: LinkPhase = LinkPhase.RECEIVING, size: int = 1000, reason: str = ""
) -> OdometryLinkStatus:
    return OdometryLinkStatus(phase, 0, reason, size, 1, 0)


def evidence(link: str = "udp://127.0.0.1:27000", **changes: Any) -> LinkEvidence:
    good: dict[str, Any] = {
        "name": "nav",
        "address": parse_address(link),
        "format": "native",
        "status": status(),
        "seconds": 5.0,
        "decoder": DecoderCounters(
            bytes_total=1000, frames=10, messages=Counter(record=10), records=10
        ),
        "owns": ("position", "attitude"),
    }
    return LinkEvidence(**(good | changes))


def test_a_link_that_is_well_has_six_good_layers() -> None:
    layers = judge_link(evidence())
    assert [layer.name for layer in layers] == list(LAYERS)
    assert {layer.verdict for layer in layers} == {"ok"}
    assert "position, attitude" in layers[-1].text


SILENT = status(LinkPhase.SILENT, 0)
CASES: dict[str, tuple[LinkEvidence, str, str]] = {
    "library": (evidence(missing_library="format mavlink needs pymavlink"), "address", "pymavlink"),
    "taken": (
        evidence(status=status(LinkPhase.BACKING_OFF, 0, "address in use")),
        "port",
        "address in use; give the source another port",
    ),
    "nothing": (
        evidence(status=SILENT, decoder=None),
        "bytes",
        "on UDP 127.0.0.1:27000: let the vehicle send to this host's port 27000; on BlueOS add",
    ),
    "silent line": (
        evidence("serial:/dev/ttyS0?baud=4800", status=SILENT, decoder=None),
        "bytes",
        "the 4800 baud",
    ),
    "other format": (
        evidence(decoder=DecoderCounters(bytes_total=1000, bytes_skipped=1000)),
        "frames",
        "none of 1000 bytes belongs to a frame of format native",
    ),
    "no origin": (
        evidence(
            format="mavlink",
            decoder=DecoderCounters(
                frames=9, messages=Counter(HEARTBEAT=9), ignored=Counter(HEARTBEAT=9)
            ),
        ),
        "checks",
        "no odometry among them (HEARTBEAT 9): the autopilot sends no position",
    ),
    "all refused": (
        evidence(
            decoder=DecoderCounters(
                frames=9, messages=Counter(record=9), rejects=Counter(zero_quaternion=9)
            )
        ),
        "checks",
        "every record is refused: zero_quaternion 9",
    ),
    "no pose": (evidence(fault="no attitude"), "poses", "no pose can be had: no attitude"),
}


@pytest.mark.parametrize(("seen", "layer", "text"), CASES.values(), ids=CASES)
def test_the_first_layer_that_fails_is_named(seen: LinkEvidence, layer: str, text: str) -> None:
    layers = {one.name: one for one in judge_link(seen)}
    assert layers[layer].verdict == "failed"
    assert text in layers[layer].text
    place = LAYERS.index(layer)
    assert all(layers[name].verdict != "failed" for name in LAYERS[:place])
    assert all(layers[name].verdict == "not tested" for name in LAYERS[place + 1 :])


def test_noise_and_single_refusals_are_doubtful_not_failures() -> None:
    decoder = DecoderCounters(
        bytes_total=1000, bytes_skipped=100, frames=10, records=9, rejects=Counter(jump=1)
    )
    verdicts = {one.name: one.verdict for one in judge_link(evidence(decoder=decoder))}
    assert [verdicts[name] for name in LAYERS[3:]] == ["doubtful", "doubtful", "ok"]


@pytest.mark.parametrize("policy", ["interpolate", "latest"])
@pytest.mark.slow
def test_the_command_watches_real_links(
    policy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], odometry_bytes: Any
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, socket.socket() as sonar:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        sonar.bind(("127.0.0.1", 0))  # bound, not listening: connections are refused
        probe.close()
        config = tmp_path / "a.yaml"
        config.write_text(
            f"device: {{address: 127.0.0.1, port: {sonar.getsockname()[1]}}}\n"
            f"time_sync: {{policy: {policy}}}\n"
            f"odometry: {{sources: [{{name: nav, link: 'udp://127.0.0.1:{port}'}}]}}\n"
        )
        stop = threading.Event()

        def send() -> None:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
                while not stop.wait(0.02):
                    link.sendto(odometry_bytes(clk="unix", t=time.time_ns()), ("127.0.0.1", port))

        sender = threading.Thread(target=send)
        sender.start()
        try:
            code = main(["doctor", "--config", str(config), "--seconds", "1", "--json"])
        finally:
            stop.set()
            sender.join()
    reported = json.loads(capsys.readouterr().out)
    assert (code, reported["failed"]) == (1, ["sonar"])
    assert {layer["verdict"] for layer in reported["links"]["nav"]} == {"ok"}
    assert (
        next(one for one in reported["links"]["sonar"] if one["verdict"] == "failed")["name"]
        == "port"
    )


@pytest.mark.parametrize("words", [["doctor"], ["--out", "out"]])
def test_levelling_that_no_source_can_serve_is_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "a.yaml"
    config.write_text(
        "world_init: {enabled: true}\n"
        "odometry: {sources: [{name: gps, format: nmea, link: 'udp://127.0.0.1:1'}]}\n"
    )
    assert main([*words, "--config", str(config)]) == 78
    problem = capsys.readouterr().err
    assert "no source of the attitude sends accelerations" in problem
    assert problem.count("\n") == 1
