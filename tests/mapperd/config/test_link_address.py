from pathlib import Path

import pytest

from mapperd.config.odometry import (
    LinkAddress,
    OdometryFusionConfig,
    OdometrySourceConfig,
    OwnersConfig,
    parse_address,
    serial_path,
)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udp://10.0.0.7:27000", LinkAddress("udp", "10.0.0.7", 27000)),
        ("tcp://192.168.194.95:16171", LinkAddress("tcp", "192.168.194.95", 16171)),
        ("tcp://[fe80::1]:16171", LinkAddress("tcp", "fe80::1", 16171)),
        ("socket://moxa.local:4001", LinkAddress("tcp", "moxa.local", 4001)),
        ("serial:/dev/ttyUSB0", LinkAddress("serial", device="/dev/ttyUSB0", baud=115200)),
        ("serial:///dev/ttyS1?baud=4800", LinkAddress("serial", device="/dev/ttyS1", baud=4800)),
        ("serial:usb-FTDI_A1-if00-port0", LinkAddress("serial", device="usb-FTDI_A1-if00-port0")),
    ],
)
def test_links_are_read(text: str, address: LinkAddress) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udp:27000",
        "udp://0.0.0.0",
        "udp://0.0.0.0:0",
        "udp://0.0.0.0:65536",
        "http://127.0.0.1:80",
        "tcp://a b:1",
        "tcp://a..b:1",
        "tcp://.:1",
        f"udp://{'a' * 64}:1",
        f"udp://{'a.' * 127}b:1",
        "serial:",
        "serial:/etc/passwd",
        "serial:/dev/../etc/passwd",
        "serial:../../etc/passwd",
        "serial:/dev/ttyS0?baud=fast",
        "serial:/dev/ttyS0?baud=99999999999999999999",
    ],
)
def test_what_is_no_link_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(ValueError, match=r"^'.*'"):
        parse_address(text)


def test_a_name_of_udev_is_looked_up_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.config.odometry.UDEV_FOLDERS", (tmp_path,))
    with pytest.raises(FileNotFoundError, match="is it plugged in"):
        serial_path("usb-DVL")
    (tmp_path / "usb-DVL").symlink_to("/dev/null")
    assert serial_path("usb-DVL") == tmp_path / "usb-DVL"
    assert serial_path("/dev/ttyS3") == Path("/dev/ttyS3")


def test_settings_refuse_wrong_links_and_owners() -> None:
    with pytest.raises(ValueError, match="is not a link"):
        OdometrySourceConfig(link="nowhere")
    with pytest.raises(ValueError, match=r"owners\.depth 'bar30' .*odometry, none"):
        OdometryFusionConfig(owners=OwnersConfig(depth="bar30"))
    with pytest.raises(ValueError, match="share a name"):
        OdometryFusionConfig(sources=(OdometrySourceConfig(), OdometrySourceConfig()))
