import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from mapperd import _core
from mapperd.config.tree import Config, MappingConfig
from mapperd.imaging.ping_image import ping_image_of
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.watchdog import Watchdog, Worker, process_progress
from oculus_driver.ping import Ping


def test_idle_is_alive_for_ever() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 1000, 5):
        assert watchdog.stuck([Worker("map", 0, 3)], now_s) == ()


def test_work_without_progress_is_not() -> None:
    watchdog = Watchdog(10)
    assert watchdog.stuck([Worker("map", 1, 3)], 0) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 10) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 10.1) == ("map",)
    assert watchdog.stuck([Worker("map", 9, 4)], 11) == ()  # it got on
    assert watchdog.stuck([Worker("map", 9, 4)], 21.5) == ("map",)


def test_time_counts_from_the_beginning_of_the_work() -> None:
    watchdog = Watchdog(10)
    watchdog.stuck([Worker("map", 0, 3)], 0)
    watchdog.stuck([Worker("map", 0, 3)], 100)
    assert watchdog.stuck([Worker("map", 1, 3)], 105) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 111) == ("map",)


def test_one_that_gets_on_does_not_hide_another() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 20, 2):
        stuck = watchdog.stuck([Worker("map", 1, now_s), Worker("store", 1, 5)], now_s)
    assert stuck == ("store",)


def test_waiting_on_purpose_is_alive() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 100, 5):
        held = Worker("recorder", 5, 1, held="no room on the disk")
        assert watchdog.stuck([held], now_s) == ()
    assert watchdog.stuck([Worker("recorder", 5, 1)], 104) == ()
    assert watchdog.stuck([Worker("recorder", 5, 1)], 106) == ("recorder",)


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_a_ping_makes_progress_part_by_part(
    ping: Callable[..., Ping], integrator: Literal["evidence_grid", "rays"]
) -> None:
    sonar_map = SonarMap(Config(mapping=MappingConfig(integrator=integrator)))
    before = _core.finished_parts()
    sonar_map.integrate(ping_image_of(ping(), sonar_map.config.sonar), np.eye(4))
    assert _core.finished_parts() > before + 10


def test_a_process_makes_progress_by_reading_and_writing_and_not_by_waiting(tmp_path: Path) -> None:
    path = tmp_path / "file"
    before = process_progress()
    path.write_bytes(bytes(1 << 20))
    written = process_progress()
    path.read_bytes()
    assert before < written < process_progress()
    idle = process_progress()
    for _ in range(100):  # as often as a process is looked at in ten minutes
        time.sleep(0.001)
    assert process_progress() <= idle + 1
