import asyncio
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore
from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.daemon import debug_pictures as module
from mapperd.daemon.debug_pictures import debug_pictures, draw_pictures, write_debug_pictures
from mapperd.events import EventLog
from mapperd.export.png import png_bytes
from mapperd.localization.picture import PATH, WATER
from mapperd.localization.status import LocalizationSnapshot
from oculus_driver.ping import Ping
from tests.mapperd.localization.believed import snapshot

MakePing = Callable[..., Ping]
SHOWN = {"visualization": {"show_opencv_visualization": True}}
SETTINGS: dict[str, Any] = {"robot_detection": {"enabled": True, "min_samples": 1}}


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (40, 3, 3)])
def test_png_is_read_back_by_another_reader(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    read = cv2.imdecode(np.frombuffer(png_bytes(image), np.uint8), cv2.IMREAD_UNCHANGED)
    assert read is not None
    np.testing.assert_array_equal(read[:, :, ::-1] if image.ndim == 3 else read, image)


def test_pictures_show_what_the_filters_and_the_bands_make_of_a_ping(ping: MakePing) -> None:
    one = ping()
    image = np.zeros(one.image.shape, one.image.dtype)
    image[5, 3], image[6, 4], image[7, 5], image[8, 6] = 20, 60, 100, 200
    one = ping(image=image)
    pictures = debug_pictures(one, config_of(SETTINGS, ""))
    rows = image.shape[0]
    assert pictures["ping"].shape == pictures["filtered"].shape == image.shape
    at = {name: picture[::-1] for name, picture in pictures.items()}
    assert [at["ping"][row, row - 2] for row in (5, 6, 7, 8)] == [20, 60, 100, 200]
    assert [at["filtered"][row, row - 2] for row in (5, 6, 7, 8)] == [0, 0, 100, 200]
    assert [tuple(at["bands"][row, row - 2]) for row in (5, 6, 7, 8)] == [
        (10, 10, 10),
        (30, 30, 30),
        module.TERRAIN,
        module.ROBOT,
    ]
    assert pictures["ping"][rows - 1 - 8, 6] == 200  # the nearest row at the bottom


def test_pictures_are_written_on_request(ping: MakePing, tmp_path: Path) -> None:
    folder = tmp_path / "state" / "debug"
    paths = write_debug_pictures(ping(), Config(), folder)
    assert [path.name for path in paths] == ["ping.png", "filtered.png", "bands.png"]
    assert sorted(folder.iterdir()) == sorted(paths)
    assert all(cv2.imread(str(path)) is not None for path in paths)


def test_localization_is_drawn_with_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DRAW_S", 0.0)
    store, events = ConfigStore(Layered(config_of(SHOWN, ""))), EventLog(lambda: 0)
    newest, path = [snapshot(known=None)], tmp_path / "debug" / "localization.png"

    def drawn(colour: tuple[int, int, int]) -> bool:
        """Whether something of that colour is seen between the two places."""
        image = cv2.imread(str(path)) if path.exists() else None
        if image is None:
            return False
        between = image[len(image) - 1 - 150, 200, ::-1]  # 50 pixels a metre from -1, -1
        return tuple(between.tolist()) == colour

    async def until(true: Callable[[], bool]) -> None:
        async with asyncio.timeout(60):
            while not true():  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.005)

    async def run() -> None:
        folder = tmp_path / "debug"
        task = asyncio.create_task(
            draw_pictures(lambda: None, store, events, folder, lambda: newest[0])
        )
        await asyncio.sleep(0.05)
        assert not path.exists()  # without a map there is nothing to be drawn
        newest[0] = at(1.0)
        await until(lambda: drawn(WATER))
        newest[0] = at(5.0)
        await until(lambda: drawn(PATH))
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(run())
    assert events.last == 0


def at(x_m: float) -> LocalizationSnapshot:
    """Localized at (x, 2), and nothing else to be seen."""
    belief = snapshot().belief
    assert belief is not None
    best = dataclasses.replace(belief.best, x_m=x_m)
    belief = dataclasses.replace(belief, best=best)
    return snapshot(belief=belief, particles=np.zeros((0, 4)), scan_points_m=None)


def test_pictures_are_drawn_while_the_setting_is_on(
    ping: MakePing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DRAW_S", 0.0)
    store, events, one = ConfigStore(Layered()), EventLog(lambda: 0), ping()
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")

    def drawn() -> int:
        return len(list(tmp_path.glob("debug/*.png")))

    async def run() -> None:
        good = asyncio.create_task(draw_pictures(lambda: one, store, events, tmp_path / "debug"))
        bad = asyncio.create_task(draw_pictures(lambda: one, store, events, blocked))
        for _ in range(20):
            await asyncio.sleep(0)
        assert drawn() == 0
        show = {"visualization.show_opencv_visualization": True}
        assert isinstance(store.apply(show, "test"), Applied)
        async with asyncio.timeout(60):
            while events.last < 1 or drawn() < 3:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.005)
        for task in (good, bad):
            task.cancel()
        await asyncio.gather(good, bad, return_exceptions=True)

    asyncio.run(run())
    assert [event.code for event in events.since(0)[0]] == ["debug_pictures"]  # reported once
