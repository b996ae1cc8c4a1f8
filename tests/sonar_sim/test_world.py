import numpy as np
import pytest
from sonar_sim.errors import EffectError, SonarSimError
from sonar_sim.geometry.driving import DriveCommand
from sonar_sim.geometry.pose import FramePose, Mounting, rotation_of
from sonar_sim.scene.scene import PointTarget, Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.vehicle import Vehicle
from sonar_sim.world import World, WorldPing

SONAR = SonarSettings(demanded_range_m=5.0, beams=64, forced_rows=200, gain_percent=75.0)
AHEAD = Mounting((0.0, 0.0, 0.0), pitch_deg=0.0)
PATTERN = "spreading,azimuth_pattern"
pytestmark = pytest.mark.filterwarnings("ignore::sonar_sim.effects.plan.EffectWarning")


def at(x: float, y: float = 0.0, yaw_rad: float = 0.0) -> FramePose:
    return FramePose(np.array([x, y, -5.0]), rotation_of(0.0, 0.0, yaw_rad))


def ball(x: float) -> Scene:
    return Scene(targets=(PointTarget("ball", (x, 0.0, -5.0), 0.0),))


def range_m(one: WorldPing) -> float:
    """Range of the loudest row."""
    return float(SONAR.row_centres_m[int(one.ping.amplitude.max(axis=1).argmax())])


def test_pings_come_at_their_rate_in_the_order_of_time() -> None:
    world = World(Scene(), effects="none")
    vehicle = world.add_vehicle("rov", at(0.0))
    vehicle.add_sonar("fast", SONAR, rate_hz=10.0)
    vehicle.add_sonar("slow", SONAR, rate_hz=4.0)
    vehicle.add_sonar("silent", SONAR, rate_hz=0.0)
    found = [(p.sonar, p.ping_id, p.time_s) for _ in range(5) for p in world.step(0.1)]
    fast = [one for one in found if one[0] == "fast"]
    assert [one[1] for one in fast] == list(range(5))
    assert [one[2] for one in fast] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert [one for one in found if one[0] == "slow"] == [("slow", 0, 0.25), ("slow", 1, 0.5)]
    times_s = [one[2] for one in found]
    assert times_s == sorted(times_s)
    assert len(world.step(0.5)) == 5 + 2


def test_a_vehicle_is_where_another_simulator_puts_it() -> None:
    world = World(ball(4.0), effects=PATTERN)
    vehicle = world.add_vehicle("rov", at(0.0))
    vehicle.add_sonar("front", SONAR, AHEAD, rate_hz=20.0)
    vehicle.move_to(at(1.0))
    pings = world.step(0.2)
    assert [p.map_T_sonar.position_m[0] for p in pings] == pytest.approx([0.25, 0.5, 0.75, 1.0])
    assert [range_m(p) for p in pings] == pytest.approx([3.75, 3.5, 3.25, 3.0], abs=0.03)
    assert vehicle.velocity_mps == pytest.approx([5.0, 0.0, 0.0])
    world.step(1.0)
    assert vehicle.pose.position_m[0] == 1.0, "it stands until it is moved again"
    vehicle.place(at(-0.5))
    assert range_m(vehicle.sonars["front"].ping()) == pytest.approx(4.5, abs=0.03)
    assert vehicle.velocity_mps == pytest.approx([0.0, 0.0, 0.0])


def test_a_driven_vehicle_comes_nearer() -> None:
    world = World(ball(4.5), effects=PATTERN)
    vehicle = world.add_vehicle("rov", at(0.0))
    vehicle.add_sonar("front", SONAR, AHEAD, rate_hz=1.0)
    vehicle.drive(DriveCommand(ahead_mps=0.5))
    ranges = [range_m(p) for _ in range(4) for p in world.step(1.0)]
    assert np.diff(ranges)[1:] == pytest.approx([-0.45, -0.5], abs=0.06)
    assert vehicle.pose.position_m[0] == pytest.approx(0.5 * (4.0 - 0.6), abs=0.02)


def test_a_sonar_sees_other_vehicles_and_not_its_own() -> None:
    world = World(Scene(), effects=PATTERN + ",lambert")
    size = (0.4, 0.4, 0.4)
    one = world.add_vehicle(Vehicle("one", size_m=size), at(0.0))
    two = world.add_vehicle(Vehicle("two", size_m=size), at(3.0, yaw_rad=np.pi))
    for vehicle in (one, two):
        vehicle.add_sonar("front", SONAR, AHEAD, rate_hz=0.0)
    assert range_m(one.sonars["front"].ping()) == pytest.approx(2.8, abs=0.05)
    two.move_to(at(2.0, yaw_rad=np.pi))
    world.step(1.0)
    for vehicle in (one, two):
        assert range_m(vehicle.sonars["front"].ping()) == pytest.approx(1.8, abs=0.05)
    labels = one.sonars["front"].ping(truth=True).ping.truth
    assert labels is not None
    third = world.add_vehicle(Vehicle("three", size_m=size), at(1.0))
    assert range_m(one.sonars["front"].ping()) == pytest.approx(0.8, abs=0.05)
    third.place(at(1.0, y=3.0))
    assert range_m(one.sonars["front"].ping()) == pytest.approx(1.8, abs=0.05)


def test_equal_worlds_give_equal_bytes_and_their_sonars_different_ones() -> None:
    def run(seed: int) -> list[bytes]:
        world = World(ball(3.0), seed=seed)
        vehicle = world.add_vehicle("rov", at(0.0))
        vehicle.add_sonar("left", SONAR, AHEAD)
        vehicle.add_sonar("right", SONAR, AHEAD)
        vehicle.drive(DriveCommand(ahead_mps=0.3, turn_rps=0.1))
        return [ping.ping.image.tobytes() for _ in range(3) for ping in world.step(0.2)]

    once = run(1)
    assert once == run(1)
    assert once != run(2)
    assert len(set(once)) == len(once) == 6


def test_what_a_world_cannot_is_refused() -> None:
    world = World(Scene())
    vehicle = world.add_vehicle("rov", at(0.0))
    vehicle.add_sonar("front", SONAR)
    with pytest.raises(SonarSimError, match="already has a vehicle 'rov'"):
        world.add_vehicle("rov", at(1.0))
    with pytest.raises(SonarSimError, match="already has a sonar 'front'"):
        vehicle.add_sonar("front", SONAR)
    with pytest.raises(SonarSimError, match="no rate"):
        vehicle.add_sonar("back", SONAR, rate_hz=-1.0)
    for dt_s in (0.0, -1.0, np.nan, 6.0):
        with pytest.raises(SonarSimError, match="step"):
            world.step(dt_s)
    with pytest.raises(SonarSimError, match="not finite"):
        vehicle.move_to(at(np.nan))
    with pytest.raises(SonarSimError, match="not finite"):
        vehicle.place(at(np.nan))
    for field in ("ahead_mps", "port_mps", "up_mps", "turn_rps"):
        for value in (np.nan, np.inf):
            with pytest.raises(SonarSimError, match=f"{field} .*not finite"):
                vehicle.drive(DriveCommand(**{field: value}))
    with pytest.raises(EffectError):
        World(Scene(), effects="magic")
