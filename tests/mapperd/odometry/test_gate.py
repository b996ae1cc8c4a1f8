import msgspec
import pytest

from mapperd.config.odometry import SlamQualityConfig
from mapperd.odometry.gate import ConfidenceGate

S = 1_000_000_000


def reason(gate: ConfidenceGate, t_s: float) -> str | None:
    reject = gate.check(round(t_s * S))
    return None if reject is None else reject.reason


@pytest.mark.parametrize(("mode", "missed"), [("open", None), ("closed", "no_confidence")])
def test_a_missing_confidence_is_what_the_mode_reports(mode: str, missed: str | None) -> None:
    gate = ConfidenceGate(msgspec.structs.replace(SlamQualityConfig(), fail_mode=mode))
    assert reason(gate, 0) is None
    gate.heard(10 * S, None)
    assert reason(gate, 11) is None  # grace
    assert reason(gate, 11.1) == missed
    gate.heard(12 * S, 0.9)
    assert reason(gate, 17) is None
    assert reason(gate, 17.1) == missed  # stale
    assert gate.unchecked == (2 if mode == "open" else 0)


def test_low_confidence_drops_until_it_is_high_again() -> None:
    gate = ConfidenceGate(SlamQualityConfig())
    for confidence, expected in ((0.39, "low_confidence"), (0.4, None), (0.0, "low_confidence")):
        gate.heard(S, confidence)
        assert reason(gate, 1) == expected
        assert gate.confidence == confidence
