"""Everything that comes in goes to disk as it came, before it is understood."""

from types import TracebackType
from typing import Self

from mapperd.config import Config
from mapperd.errors import ConfigError
from mapperd.odometry.bridge import encoding_of
from oculus_driver.errors import RecordingError
from oculus_driver.link_state import LinkState, LinkStatus
from oculus_driver.recording import BackgroundLog, LogPolicy, SonarLog

__all__ = ["Recorder"]

MIB = 1 << 20


class Recorder:
    """Records all links, `async with`; without a folder it does nothing.

    Args:
        config: `recording` and the sources of the odometry. Arrivals are Unix nanoseconds.

    Raises:
        ConfigError: the folder cannot be made, or the limits contradict each other.
    """

    def __init__(self, config: Config) -> None:
        self._log: BackgroundLog | None = None
        self._fresh = False
        settings = config.recording
        if not settings.folder:
            return
        try:
            policy = LogPolicy(
                max_file_bytes=settings.max_file * MIB,
                budget_bytes=settings.budget * MIB or None,
                free_floor_bytes=settings.free_floor * MIB,
            )
            sources = {source.name: encoding_of(source) for source in config.odometry.sources}
            self._files = SonarLog(settings.folder, policy, prefix="dive", others=sources)
        except RecordingError as error:
            raise ConfigError(f"recording: {error}", "$.recording") from error
        self._log = BackgroundLog(self._files)

    async def __aenter__(self) -> Self:
        """Begin to record."""
        if self._log is not None:
            await self._log.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write what waits."""
        if self._log is not None:
            await self._log.__aexit__(kind, error, trace)

    def sonar_bytes(self, data: bytes, arrival_ns: int) -> None:
        """Record bytes of the sonar."""
        if self._log is not None:
            self._log.write(data, arrival_ns, gap_before=self._fresh)
            self._fresh = False

    def sonar_link(self, status: LinkStatus) -> None:
        """Bytes of a new connection do not join the old ones."""
        self._fresh = self._fresh or status.state == LinkState.CONNECTING

    def link_bytes(self, name: str, data: bytes, arrival_ns: int, *, gap: bool) -> None:
        """Record bytes of a source of odometry."""
        if self._log is not None:
            self._log.write_other(name, data, arrival_ns, gap_before=gap)

    def status(self) -> dict[str, object] | None:
        """For a person: what it does and what was lost; None where nothing is recorded."""
        if self._log is None:
            return None
        counters = self._files.counters
        return {
            "state": self._files.state,
            "reason": self._files.reason,
            "bytes_written": counters.bytes_written,
            "bytes_dropped": counters.bytes_dropped + self._log.bytes_dropped,
            "drops": dict(counters.drops),
            "files": counters.files_opened,
        }
