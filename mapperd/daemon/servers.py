"""What runs beside the mapping: telemetry, and debug pictures."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path

from mapperd.daemon.daemon import Daemon
from mapperd.daemon.debug_pictures import draw_pictures
from mapperd.telemetry.telemetry import Telemetry
from oculus_driver.ping import Ping

__all__ = ["serving"]


@contextlib.asynccontextmanager
async def serving(
    daemon: Daemon, folder: Path, environment: Mapping[str, str], clock: Callable[[], int]
) -> AsyncIterator[None]:
    """Run them as long as this lasts; they end after the daemon, so that its end is told.

    Args:
        daemon: what they tell of, and ask.
        folder: for its state.
        environment: says where systemd has put credentials.
        clock: Unix time in nanoseconds that is never set back.

    Raises:
        ConfigError: the settings name a broker that cannot be talked to.
    """

    def newest() -> Ping | None:
        settled = daemon.live.mapping.newest
        return None if settled is None else settled.ping

    tasks = []
    if daemon.settings.current.mqtt.host:
        telemetry = Telemetry(daemon, (folder,), environment, clock)
        daemon.servers["mqtt"] = telemetry.status
        tasks.append(asyncio.create_task(telemetry.run()))
    pictures = draw_pictures(
        newest,
        daemon.settings,
        daemon.events,
        folder / "debug",
        lambda: daemon.live.mapping.facts.localization,
    )
    tasks.append(asyncio.create_task(pictures))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
