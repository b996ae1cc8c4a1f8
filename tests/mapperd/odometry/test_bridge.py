"""Any bytes on any link: nothing raises, and every record is counted once."""

from collections.abc import Callable
from typing import Any, get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mapperd.config.odometry import FormatName, OdometryFusionConfig, OdometrySourceConfig
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.native import NativeRecord, encode_native, encode_native_serial
from tests.support.peers.autopilot import Autopilot
from tests.support.peers.dvl import Dvl
from tests.support.peers.nmea_talker import NmeaTalker

T0 = 1_700_000_000_000_000_000
NAMES: tuple[FormatName, ...] = get_args(FormatName)
JSON = (
    b'{"v":1,"clk":"arrival","w":"enu","b":"flu","p":[1e6,0,0],"q":[1,0,0,0],"u":[900,0,0]}\n',
    b'{"v":1,"clk":"boot","t":-9223372036854775808,"w":"ned","b":"frd","q":[0,0,0,0]}\n',
    b'{"v":1,"clk":"unix","t":1700000000000000000,"w":"local_frd","b":"frd","r":[0,0,9]}\n',
)


def _native() -> list[NativeRecord]:
    stated: dict[str, Any] = {"v": 1, "w": "enu", "b": "flu"}
    return [
        NativeRecord(**stated, clk="boot", t=10**9, p=(0.0, 0.0, 0.0), q=(1.0, 0.0, 0.0, 0.0)),
        NativeRecord(**stated, clk="boot", t=2**63 - 1, p=(9e6, 0.0, 0.0), q=(0.0, 1.0, 0.0, 0.0)),
        NativeRecord(**stated, clk="arrival", u=(900.0, -900.0, 0.0), r=(0.0, 900.0, 0.0)),
        NativeRecord(**stated, clk="unix", t=T0, q=(1.0, 0.0, 0.0, 0.0), a=(0.0, 0.0, 9.81)),
        NativeRecord(**stated, clk="unix", t=T0, q=(1e-9, 0.0, 0.0, 0.0)),
    ]


def messages(name: FormatName) -> list[bytes]:
    """Good and extreme ones of a format."""
    autopilot, dvl, talker = Autopilot(), Dvl(), NmeaTalker()
    return {
        "native": [encode_native(record) for record in _native()],
        "native_serial": [encode_native_serial(record) for record in _native()],
        "native_json": list(JSON),
        "mavlink": [
            autopilot.local_position((1, 2, 3), (0.1, 0, 0)),
            autopilot.attitude((0.1, 0.2, 3.0)),
            autopilot.odometry(q=[float("nan")] * 4),
            autopilot.odometry(reset_counter=3, x=9e6),
            autopilot.global_position(),
            autopilot.pressure(1500.0),
            autopilot.heartbeat(),
        ],
        "water_linked_json": [
            dvl.velocity(),
            dvl.velocity(velocity_valid=False),
            dvl.position(),
            dvl.response(),
            dvl.velocity((1e300, 0, 0)),
        ],
        "water_linked_serial": [
            dvl.velocity_sentence(),
            dvl.velocity_sentence(valid=False),
            dvl.position_sentence(),
        ],
        "nmea": [
            talker.gga(),
            talker.rmc(),
            talker.vtg(),
            talker.hdt(),
            talker.prdid("1.0", "2.0", "359.0"),
            talker.pashr("10.0", "0.0", "0.0"),
            talker.zda(),
        ],
    }[name]


def pieces(name: FormatName) -> st.SearchStrategy[list[bytes]]:
    """Whole, damaged and senseless pieces, cut anywhere."""
    good = st.sampled_from(messages(name))
    damaged = st.builds(
        lambda data, at, byte: data[: at % len(data)] + bytes([byte]) + data[at % len(data) + 1 :],
        good,
        st.integers(0, 500),
        st.integers(0, 255),
    )
    cut = st.builds(lambda data, at: data[: at % (len(data) + 1)], good, st.integers(0, 500))
    return st.lists(st.one_of(good, good, damaged, cut, st.binary(max_size=60)), max_size=25)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scheme", ["udp", "tcp", "serial"])
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
@given(data=st.data())
def test_any_bytes_on_any_link(name: FormatName, scheme: str, data: st.DataObject) -> None:
    if name == "native" and scheme != "udp":
        return  # refused by the settings: it has no frames
    link = "serial:/dev/ttyS0" if scheme == "serial" else f"{scheme}://127.0.0.1:52200"
    source = OdometrySourceConfig(name="any", format=name, link=link, mavlink_system_id=0)
    bridge = OdometryBridge(Config(odometry=OdometryFusionConfig(sources=(source,))))
    arrival_ns = T0
    for piece in data.draw(pieces(name)):
        arrival_ns += data.draw(st.sampled_from([0, 1, 50_000_000, -(10**9), 10**11]))
        gap = data.draw(st.booleans())
        stamp = data.draw(st.sampled_from([arrival_ns, arrival_ns, None]))
        bridge.feed("any", piece, stamp, gap_before=gap)
        bridge.fusion.ready(arrival_ns)
        assert isinstance(bridge.fusion.at(arrival_ns), FusedPose | Reject)
        assert bridge.received == bridge.accepted + bridge.rejects.total()
    bridge.status()


def test_a_link_that_nobody_configured_is_counted() -> None:
    bridge = OdometryBridge(Config())
    bridge.feed("stranger", b"x", None)
    bridge.feed("stranger", b"x", None, encoding="odometry-smoke_signals")
    assert bridge.status()["unreadable"] == {"stranger": 2}
    assert bridge.received == 0


def test_a_fault_of_a_decoder_costs_its_bytes_only(
    monkeypatch: pytest.MonkeyPatch, odometry_bytes: Callable[..., bytes]
) -> None:
    bridge = OdometryBridge(Config())
    bridge.feed("odometry", odometry_bytes(), 1)
    decoder = bridge.decoder_of("odometry")

    def fails(*_: object) -> None:
        raise RuntimeError("unforeseen")

    with monkeypatch.context() as patch:
        patch.setattr(type(decoder), "feed", fails)
        bridge.feed("odometry", odometry_bytes(), 2)
    bridge.feed("odometry", odometry_bytes(), 3)
    assert bridge.rejects == {"internal_error": 1}
    assert bridge.accepted == 2
