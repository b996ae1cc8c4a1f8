"""The bridge: turns bytes of the vehicle's links into records, and records into poses."""

from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

from mapperd.config.odometry import SONAR, FormatSettings, OdometrySourceConfig, parse_address
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError, Reject
from mapperd.imaging.ping_image import ping_image_of
from mapperd.odometry.decoder import Decoder
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.fusion import Fusion, FusionState
from mapperd.odometry.records import Odometry
from mapperd.odometry.sonar_odometry import (
    SonarOdometry,
    SonarOdometryState,
    sonar_odometry,
)
from oculus_driver.ping import Ping

__all__ = ["ENCODING_PREFIX", "BridgeState", "OdometryBridge", "encoding_of"]

ENCODING_PREFIX = "odometry-"
"""Prefix of the encodings of recorded links with odometry; the format's name follows."""


def encoding_of(settings: FormatSettings) -> str:
    """Return the encoding of a recorded link of this format."""
    return ENCODING_PREFIX + settings.format


class BridgeState(NamedTuple):
    """State of an `OdometryBridge`.

    Attributes:
        decoders: encoding and decoder state by link.
        unreadable: number of pieces without a decoder, by link.
        accepted: as in `OdometryBridge`.
        fusion: state of the fusion.
        sonar: state of the sonar odometry; None without one.
        sonar_records: number of its records.
    """

    decoders: dict[str, tuple[str | None, Any]]
    unreadable: dict[str, int]
    accepted: int
    fusion: FusionState
    sonar: SonarOdometryState | None = None
    sonar_records: int = 0


class OdometryBridge:
    """All odometry of one vehicle, live or recorded.

    Args:
        config: the sources and the fusion.

    Attributes:
        fusion: combines the records.
        accepted: number of records of which anything was used.
        sonar: sonar odometry, if enabled.
    """

    def __init__(self, config: Config) -> None:
        self._sources = {source.name: source for source in config.odometry.sources}
        self._decoders: dict[str, Decoder] = {}
        self._encodings: dict[str, str | None] = {}
        self._unreadable: Counter[str] = Counter()
        self.accepted = 0
        self.fusion = Fusion(
            config.odometry,
            config.time_sync,
            config.slam_quality,
            config.world_init,
            {name: source.latency_sec for name, source in self._sources.items()},
        )
        self.sonar: SonarOdometry | None = sonar_odometry(config)
        self._sonar_config = config.sonar
        self._sonar_heads = config.odometry.owners.attitude == SONAR
        self._sonar_records = 0

    def feed(
        self,
        link: str,
        data: bytes,
        arrival_ns: int | None,
        *,
        encoding: str | None = None,
        gap_before: bool = False,
    ) -> None:
        """Process the next bytes of a link.

        Args:
            link: name of a source, or of a recorded link.
            data: any piece of a stream, or exactly one datagram.
            arrival_ns: arrival time, host clock; None if the recording has no time.
            encoding: encoding of a recorded link; gives the format if no source has its name.
            gap_before: bytes before these are missing.
        """
        decoder = self._decoders.get(link)
        if decoder is None:
            found = self._decoder(link, encoding)
            if found is None:
                self._unreadable[link] += 1
                return
            decoder = self._decoders[link] = found
            self._encodings[link] = encoding
        if gap_before:
            decoder.restart()
        for record in self._decoded(decoder, data, arrival_ns):
            if not isinstance(record, Reject) and (
                self.fusion.take(link, record, arrival_ns) is None
            ):
                self.accepted += 1

    def reconfigure(self, config: Config) -> None:
        """Use other settings from now on; they differ only in what may change while running."""
        self.fusion.reconfigure(config.odometry, config.time_sync, config.slam_quality)
        if self.sonar is not None:
            self.sonar.reconfigure(config)

    def awaits_attitude(self, t_ns: int) -> bool:
        """Whether a ping of that time cannot be registered yet."""
        return not (self._sonar_heads or self.fusion.attitude_is_settled(t_ns))

    def register(self, ping: Ping, t_ns: int) -> None:
        """Measure the motion up to a ping, and fuse it as a record of the source `sonar`.

        Args:
            ping: later than all before.
            t_ns: its time, host clock.
        """
        if self.sonar is None:
            return
        try:
            image = ping_image_of(ping, self._sonar_config)
        except MapError as error:
            self.sonar.skip(Reject(error.reason, str(error)))
            return
        attitude = None if self._sonar_heads else self.fusion.attitude_at(t_ns)
        if isinstance(attitude, Reject):
            self.sonar.skip(attitude)
            return
        for record in self.sonar.records(image, t_ns, attitude):
            self._sonar_records += 1
            # Its stamps are of the host's clock already.
            if self.fusion.take(SONAR, record, record.stamp_ns) is None:
                self.accepted += 1

    def state(self) -> BridgeState:
        """Return the state for `restore`."""
        decoders = {
            link: (self._encodings[link], decoder.state())
            for link, decoder in self._decoders.items()
        }
        return BridgeState(
            decoders,
            dict(self._unreadable),
            self.accepted,
            self.fusion.state(),
            None if self.sonar is None else self.sonar.state(),
            self._sonar_records,
        )

    def restore(self, state: BridgeState) -> None:
        """Restore the state of a bridge with the same settings.

        Raises:
            ValueError: a format cannot be decoded here, or the state is of another format or of
                other settings of the sonar odometry.
        """
        if (self.sonar is None) != (state.sonar is None):
            raise ValueError("the state is of other settings of odometry.sonar")
        for link, (encoding, inner) in state.decoders.items():
            decoder = self._decoder(link, encoding)
            if decoder is None:
                raise ValueError(f"{link!r} cannot be read: {encoding!r}")
            decoder.restore(inner)
            self._decoders[link], self._encodings[link] = decoder, encoding
        self._unreadable = Counter(state.unreadable)
        self.accepted = state.accepted
        self.fusion.restore(state.fusion)
        if self.sonar is not None and state.sonar is not None:
            self.sonar.restore(state.sonar)
        self._sonar_records = state.sonar_records

    @staticmethod
    def _decoded(
        decoder: Decoder, data: bytes, arrival_ns: int | None
    ) -> Iterator[Odometry | Reject]:
        """Yield the decoder's records; an error in a decoder loses these bytes only."""
        try:
            yield from decoder.feed(data, arrival_ns)
        except Exception as error:  # noqa: BLE001 decoders are total; this is what if not
            decoder.restart()
            yield decoder.counters.out(Reject("internal_error", f"{type(error).__name__}: {error}"))

    @property
    def received(self) -> int:
        """Number of received records, valid or not."""
        return self._sonar_records + sum(
            decoder.counters.records + decoder.counters.rejects.total()
            for decoder in self._decoders.values()
        )

    @property
    def rejects(self) -> Counter[str]:
        """Counts by reason, of decoding and fusion; received == accepted + their sum."""
        counts: Counter[str] = Counter()
        for decoder in self._decoders.values():
            counts += decoder.counters.rejects
        for rejects in self.fusion.rejects.values():
            counts += rejects
        return counts

    def decoder_of(self, link: str) -> Decoder | None:
        """Return the decoder of a link; None before its first bytes."""
        return self._decoders.get(link)

    def status(self) -> dict[str, Any]:
        """Status for people: bytes, frames and records by link, and the fusion."""
        links = {
            name: {
                "bytes": decoder.counters.bytes_total,
                "bytes_skipped": decoder.counters.bytes_skipped,
                "frames": decoder.counters.frames,
                "messages": dict(sorted(decoder.counters.messages.items())),
                "ignored": dict(sorted(decoder.counters.ignored.items())),
                "records": decoder.counters.records,
                "rejected": dict(sorted(decoder.counters.rejects.items())),
            }
            for name, decoder in self._decoders.items()
        }
        status = {"links": links, "unreadable": dict(self._unreadable), **self.fusion.status()}
        if self.sonar is not None:
            status["sonar"] = self.sonar.status()
        return status

    def _decoder(self, link: str, encoding: str | None) -> Decoder | None:
        source = self._sources.get(link)
        if source is not None and encoding in (None, encoding_of(source)):
            datagrams = parse_address(source.link).kind == "udp"
            return make_decoder(source, datagrams=datagrams)
        try:
            format_name = (encoding or "").removeprefix(ENCODING_PREFIX)
            return make_decoder(OdometrySourceConfig(format=format_name))  # type: ignore[arg-type]
        except (ConfigError, KeyError):
            return None
