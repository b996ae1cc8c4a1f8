"""Pings made for fire messages, without sockets."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sonar_sim.device.fire_settings import initial_request
from sonar_sim.device.ping_generator import PingGenerator, TransmitState
from sonar_sim.scene.scenario import Scenario

from oculus_driver import Ping, StreamParser, decode_ping
from oculus_driver.virtual_sonar.device import FireRequest
from oculus_driver.wire import FireFlags

MakeScenario = Callable[..., Scenario]


def maker_of(scenario: Scenario) -> PingGenerator:
    return PingGenerator(scenario.scene, scenario.sonar, scenario.mounting, seed=5, source_id=7)


def when_of(scenario: Scenario, ping_id: int = 1, time_s: float = 1.0) -> TransmitState:
    path = scenario.trajectory
    state = path.pose(time_s), path.velocity_mps(time_s), path.turn_rates_rps(time_s)
    return TransmitState(ping_id, 100.0 + time_s, time_s, *state)


def ping_of(data: bytes) -> Ping:
    parser = StreamParser()
    (message,) = parser.feed(data) + parser.finish()
    ping = decode_ping(message)
    assert isinstance(ping, Ping)
    return ping


def test_pings_are_the_same_in_whatever_order_they_are_made(floor_scenario: MakeScenario) -> None:
    scenario = floor_scenario()
    demand = initial_request(scenario.sonar, 10.0)
    whens = [when_of(scenario, 1, 1.0), when_of(scenario, 2, 1.1)]
    one, other = maker_of(scenario), maker_of(scenario)
    ahead = [one.make(demand, when) for when in whens]
    back = [other.make(demand, when) for when in reversed(whens)]
    assert ahead == back[::-1]
    assert ping_of(ahead[0]).image.tolist() != ping_of(ahead[1]).image.tolist()


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_scientific_samples_come_without_varying_gain(
    floor_scenario: MakeScenario, bits: int
) -> None:
    scenario = floor_scenario()
    flags = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN | FireFlags.SEND_GAIN
    demand = FireRequest(
        flags=flags | (FireFlags.SIXTEEN_BIT if bits > 8 else 0),
        extended_flags=0x200 if bits == 32 else 0,
        range_demand=3.0,
    )
    ping = ping_of(maker_of(scenario).make(demand, when_of(scenario)))
    assert ping.bits_per_sample == bits
    assert ping.gains is not None
    lifted = ping.gains[-1] / ping.gains[0]
    assert (lifted == 1.0) if bits == 32 else (lifted > 1e4)


def test_levels_do_not_depend_on_the_gain_once_it_is_taken_out(
    floor_scenario: MakeScenario,
) -> None:
    scenario = floor_scenario()
    flags = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN | FireFlags.SEND_GAIN
    demand = FireRequest(flags=flags | FireFlags.SIXTEEN_BIT, range_demand=3.0, gain_percent=30.0)
    varied = ping_of(maker_of(scenario).make(demand, when_of(scenario)))
    flat = ping_of(
        maker_of(scenario).make(replace(demand, extended_flags=0x200), when_of(scenario))
    )
    floor = np.abs(varied.ranges_m - 2.0) < 0.3
    ratio = varied.amplitude()[floor] / np.maximum(flat.amplitude()[floor], 1e-12)
    loud = (varied.image[floor] > 100) & (varied.image[floor] < 65535)
    assert loud.sum() > 1000
    spread_db = 20.0 * np.log10(ratio[loud].max() / ratio[loud].min())
    assert spread_db < 0.5
