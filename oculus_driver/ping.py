"""Pings: decoded sonar images with their geometry, times and warnings; sequence of ping ids."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from oculus_driver.errors import Reject
from oculus_driver.fan import CENTIDEGREE_RAD, edges_rad
from oculus_driver.ping_layout import GAIN_WORD, PingLayout, resolve_layout
from oculus_driver.wire import FireFlags, MessageId, ping_result_layout

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.stream import Message
    from oculus_driver.wire import Layout


NOMINAL_SPEED_OF_SOUND_MPS: Final = 1500.0
_SPEED_LIMITS_MPS: Final = (1300.0, 1700.0)
_TEMPERATURE_LIMITS_C: Final = (-40.0, 120.0)
_PRESSURE_LIMITS_BAR: Final = (-5.0, 1000.0)
_HEADING_LIMITS_DEG: Final = (-360.0, 360.0)
_TILT_LIMITS_DEG: Final = (-180.0, 180.0)
_COMMON_BEAMS: Final = (256, 512)
_TABLE_END_RAD: Final = math.pi / 2

_MIN_READING: Final = 1e-30
"""Sensors report 0 or a much larger value. Uninitialised memory in captures is below this."""

_BITS_24: Final = 3
_U32: Final = struct.Struct("<I")


@dataclass(frozen=True, slots=True, eq=False)
class Ping:
    """One ping. Arrays are read-only; the image is a view of the message's bytes.

    Attributes:
        ping_id: increases by one per ping, wraps at 2³², restarts at power-up.
        arrival_ns: arrival time of the first byte of the message on the stream's clock, or None.
        offset: offset of the message in its stream.
        version: 1 or 2, layout of the message.
        source_id: low 16 bits of the sonar's device id.
        part_number: see `oculus_driver.models`; 0 from older firmware.
        mode: 1 low frequency, wide; 2 high frequency, narrow.
        flags: echo of the fire flags, see `oculus_driver.wire.FireFlags`.
        status: raw status word, meaning unknown.
        frequency_hz: acoustic frequency, NaN if it is not a positive number.
        range_setting_m: requested range, None if it was requested in percent. The image ends at
            `max_range_m`, not here.
        gain_percent: gain in use, NaN if not finite.
        gamma: exponent gamma/255 was applied to the image; 0 and 255 mean linear.
        speed_of_sound_mps: speed of sound used by the sonar, as sent.
        salinity_ppt: as sent, NaN if not finite.
        range_resolution_m: depth of one row.
        bearings_rad: float64 (beams,), positive to starboard.
        image: (rows, beams) of uint8, uint16 or uint32, nearest row first; may be unaligned.
        bits_per_sample: 8, 16, 24 or 32.
        gains: uint32 (rows,) gain words, or None. 0 means that the gain of the row is unknown.
        start_time_s: seconds since power-up (version 2), else None.
        start_ticks: clock ticks of undocumented length, modulo 2³² (version 1), else None.
        temperature_c, pressure_bar: of the water; None = not available.
        heading_rad, pitch_rad, roll_rad: attitude of the sonar, conventions undocumented; None =
            not available (always in version 1).
        warnings: any of odd_beams, bad_bearings, odd_sound_speed, bad_frequency, gain_flag,
            bad_data_size, size_mismatch, unconfirmed_end (from the stream, see
            `oculus_driver.stream.Message`).
    """

    ping_id: int
    arrival_ns: int | None
    offset: int
    version: int
    source_id: int
    part_number: int
    mode: int
    flags: int
    status: int
    frequency_hz: float
    range_setting_m: float | None
    gain_percent: float
    gamma: int
    speed_of_sound_mps: float
    salinity_ppt: float
    range_resolution_m: float
    bearings_rad: NDArray[np.float64] = field(repr=False)
    image: NDArray[Any] = field(repr=False)
    bits_per_sample: int
    gains: NDArray[np.uint32] | None = field(repr=False)
    start_time_s: float | None
    start_ticks: int | None
    temperature_c: float | None
    pressure_bar: float | None
    heading_rad: float | None
    pitch_rad: float | None
    roll_rad: float | None
    warnings: frozenset[str]

    @property
    def rows(self) -> int:
        """Number of ranges."""
        return int(self.image.shape[0])

    @property
    def beams(self) -> int:
        """Number of bearings."""
        return int(self.image.shape[1])

    @property
    def has_gains(self) -> bool:
        """Whether the rows have gain words."""
        return self.gains is not None

    @property
    def max_range_m(self) -> float:
        """Far end of the image, metres."""
        return self.rows * self.range_resolution_m

    @property
    def ranges_m(self) -> NDArray[np.float64]:
        """Centres of the rows, float64 (rows,): (k + ½)·resolution.

        The true offset of row 0 is not documented; other programs use k or k + 1.
        """
        centres: NDArray[np.float64] = np.arange(0.5, self.rows) * self.range_resolution_m
        return centres

    @property
    def full_scale(self) -> int:
        """Largest possible sample value."""
        return (1 << self.bits_per_sample) - 1

    @property
    def row_valid(self) -> NDArray[np.bool_]:
        """Bool (rows,): False if the gain word is 0 and the level of the row is unknown."""
        return np.ones(self.rows, dtype=np.bool_) if self.gains is None else self.gains != 0

    def amplitude(self) -> NDArray[np.float32]:
        """Return the echo level, float32 (rows, beams): sample / sqrt(gain of the row).

        All values are finite. Rows without a gain (`row_valid` is False) are 0: unknown, not
        silent.
        """
        samples = self.image.astype(np.float32)
        if self.gains is None:
            return samples
        scale = np.zeros(self.rows, dtype=np.float32)
        valid = self.row_valid
        scale[valid] = 1.0 / np.sqrt(self.gains[valid].astype(np.float64))
        samples *= scale[:, np.newaxis]
        return samples

    def beam_edges_rad(self) -> NDArray[np.float64]:
        """Return the edges between beams, float64 (beams + 1,), halfway in sine."""
        return edges_rad(self.bearings_rad)

    def transmit_time_ns(self, latency_ns: int = 0) -> int | None:
        """Return the transmit time of the ping on the clock of `arrival_ns`.

        Computed from this ping alone: arrival minus two-way travel time to the end of the image. If
        the sonar reports its start time, `oculus_driver.clock` is more accurate.

        Args:
            latency_ns: processing and network time between the last echo and the first byte.
        """
        if self.arrival_ns is None:
            return None
        return self.arrival_ns - latency_ns - self.flight_ns(2.0 * self.max_range_m)

    def echo_time_ns(self, range_m: float, latency_ns: int = 0) -> int | None:
        """Return when the sound met a target at `range_m`, the time of the pose to use."""
        start = self.transmit_time_ns(latency_ns)
        return None if start is None else start + self.flight_ns(range_m)

    def flight_ns(self, distance_m: float) -> int:
        """Return the travel time of sound over a distance, at `credible_speed_of_sound_mps`."""
        return round(distance_m / self.credible_speed_of_sound_mps * 1e9)

    @property
    def credible_speed_of_sound_mps(self) -> float:
        """Speed of sound for travel times: as sent, or 1500 m/s if that is implausible.

        The replacement (warning odd_sound_speed) is at most 15 % off.
        """
        speed, (low, high) = self.speed_of_sound_mps, _SPEED_LIMITS_MPS
        return speed if low <= speed <= high else NOMINAL_SPEED_OF_SOUND_MPS


@dataclass(frozen=True, slots=True)
class PingHeader:
    """A valid ping message whose bearings and image are not decoded; `decode` returns its ping.

    Attributes:
        message: the message.
        layout: offsets inside the message.
        fields: the fixed part as sent, by name.

    The other attributes are those of `Ping`.
    """

    message: Message = field(repr=False)
    layout: PingLayout = field(repr=False)
    fields: dict[str, Any] = field(repr=False)
    ping_id: int
    part_number: int
    mode: int
    flags: int
    range_setting_m: float | None
    gain_percent: float
    gamma: int
    speed_of_sound_mps: float
    salinity_ppt: float
    beams: int
    bits_per_sample: int
    has_gains: bool
    start_time_s: float | None
    start_ticks: int | None
    temperature_c: float | None

    def decode(self) -> Ping:
        """Return the ping."""
        message, layout, fields = self.message, self.layout, self.fields
        bearings_rad = _bearings_rad(message.data, layout)
        frequency_hz = fields["frequency_hz"]
        return Ping(
            ping_id=self.ping_id,
            arrival_ns=message.arrival_ns,
            offset=message.offset,
            version=max(1, message.version),
            source_id=message.source_id,
            part_number=self.part_number,
            mode=self.mode,
            flags=self.flags,
            status=fields["status"],
            frequency_hz=frequency_hz if _is_frequency(frequency_hz) else math.nan,
            range_setting_m=self.range_setting_m,
            gain_percent=self.gain_percent,
            gamma=self.gamma,
            speed_of_sound_mps=self.speed_of_sound_mps,
            salinity_ppt=self.salinity_ppt,
            range_resolution_m=fields["range_resolution_m"],
            bearings_rad=bearings_rad,
            image=_image(message.data, layout),
            bits_per_sample=self.bits_per_sample,
            gains=_gains(message.data, layout),
            start_time_s=self.start_time_s,
            start_ticks=self.start_ticks,
            temperature_c=self.temperature_c,
            pressure_bar=_reading(fields["pressure_bar"], _PRESSURE_LIMITS_BAR),
            heading_rad=_angle_rad(fields.get("heading_deg"), _HEADING_LIMITS_DEG),
            pitch_rad=_angle_rad(fields.get("pitch_deg"), _TILT_LIMITS_DEG),
            roll_rad=_angle_rad(fields.get("roll_deg"), _TILT_LIMITS_DEG),
            warnings=message.warnings | layout.warnings | _warnings(fields, bearings_rad),
        )


def decode_ping(message: Message, *, deliver_mismatched: bool = False) -> Ping | Reject:
    """Return the ping in a message, or why it is invalid. Never raises on any bytes.

    Args:
        message: message of any id.
        deliver_mismatched: return a ping with contradicting sizes, with the warning
            size_mismatch, if its table and image lie inside the message.
    """
    header = decode_header(message, deliver_mismatched=deliver_mismatched)
    return header if isinstance(header, Reject) else header.decode()


def decode_header(message: Message, *, deliver_mismatched: bool = False) -> PingHeader | Reject:
    """Return the header of the ping in a message, or a `Reject`; arguments as `decode_ping`.

    It rejects the same messages as `decode_ping` and takes a fraction of its time.
    """
    if message.message_id != MessageId.PING_RESULT:
        return Reject("not_a_ping", f"message id {message.message_id:#x}", message.offset)
    layout = ping_result_layout(message.version)
    if layout is None:
        return Reject("unknown_version", f"ping result version {message.version}", message.offset)
    if len(message.data) < layout.size:
        detail = f"{len(message.data)} bytes, a {layout.name} has {layout.size}"
        return Reject("short_message", detail, message.offset, _ping_id(message.data, layout))
    fields = layout.unpack(message.data)
    parts = resolve_layout(message, layout, fields, deliver_mismatched=deliver_mismatched)
    if isinstance(parts, Reject):
        return parts
    in_metres = fields["flags"] & FireFlags.RANGE_IN_METRES
    return PingHeader(
        message=message,
        layout=parts,
        fields=fields,
        ping_id=fields["ping_id"],
        part_number=message.part_number,
        mode=fields["mode"],
        flags=fields["flags"],
        range_setting_m=_within(fields["range_demand"], 0.0, math.inf) if in_metres else None,
        gain_percent=_finite_or_nan(fields["gain_percent"]),
        gamma=fields["gamma"],
        speed_of_sound_mps=fields["speed_of_sound_mps"],
        salinity_ppt=_finite_or_nan(fields["salinity_ppt"]),
        beams=parts.beams,
        bits_per_sample=8 * parts.width,
        has_gains=parts.gain_words,
        start_time_s=_within(fields.get("start_time_s"), 0.0, math.inf),
        start_ticks=fields.get("start_ticks"),
        temperature_c=_reading(fields["temperature_c"], _TEMPERATURE_LIMITS_C),
    )


def _ping_id(data: bytes, layout: Layout) -> int | None:
    """Return the id of a ping that is cut inside its fixed part, None if the id is missing, too."""
    offset = layout.offset_of("ping_id")
    if len(data) < offset + _U32.size:
        return None
    return int(_U32.unpack_from(data, offset)[0])


def _bearings_rad(data: bytes, parts: PingLayout) -> NDArray[np.float64]:
    table = np.frombuffer(data, dtype="<i2", count=parts.beams, offset=parts.table_offset)
    bearings: NDArray[np.float64] = table * CENTIDEGREE_RAD
    bearings.flags.writeable = False
    return bearings


def _image(data: bytes, parts: PingLayout) -> NDArray[Any]:
    """Return the samples: a view of the message, or a copy of 24-bit samples."""
    offset = parts.image_offset + (GAIN_WORD if parts.gain_words else 0)
    size = (parts.rows, parts.beams)
    if parts.width != _BITS_24:
        strides = (parts.stride, parts.width)
        return np.ndarray(size, f"<u{parts.width}", buffer=data, offset=offset, strides=strides)
    low = np.ndarray(size, "<u2", data, offset, (parts.stride, 3))
    high = np.ndarray(size, np.uint8, data, offset + 2, (parts.stride, 3))
    samples = low.astype(np.uint32)
    samples |= high.astype(np.uint32) << 16
    samples.flags.writeable = False
    return samples


def _gains(data: bytes, parts: PingLayout) -> NDArray[np.uint32] | None:
    if not parts.gain_words:
        return None
    words = np.ndarray((parts.rows,), "<u4", data, parts.image_offset, (parts.stride,))
    gains = words.astype(np.uint32)
    gains.flags.writeable = False
    return gains


def _warnings(fields: dict[str, Any], bearings_rad: NDArray[np.float64]) -> frozenset[str]:
    steps_back = bool((np.diff(bearings_rad) <= 0.0).any())
    outside = bool((np.abs(bearings_rad) > _TABLE_END_RAD + CENTIDEGREE_RAD / 2).any())
    speed = fields["speed_of_sound_mps"]
    warnings = {
        "odd_beams": fields["beams"] not in _COMMON_BEAMS,
        "bad_bearings": steps_back or outside,
        "odd_sound_speed": not _SPEED_LIMITS_MPS[0] <= speed <= _SPEED_LIMITS_MPS[1],
        "bad_frequency": not _is_frequency(fields["frequency_hz"]),
    }
    return frozenset(name for name, active in warnings.items() if active)


def _is_frequency(value: float) -> bool:
    return math.isfinite(value) and value > 0.0


def _finite_or_nan(value: float) -> float:
    return value if math.isfinite(value) else math.nan


def _within(value: float | None, low: float, high: float) -> float | None:
    """Return the value if it is finite and within the limits, else None."""
    if value is None or not math.isfinite(value) or not low <= value <= high:
        return None
    return value


def _reading(value: float | None, limits: tuple[float, float]) -> float | None:
    """Return a plausible sensor value, else None."""
    if value is not None and 0.0 < abs(value) < _MIN_READING:
        return None
    return _within(value, *limits)


def _angle_rad(value: float | None, limits: tuple[float, float]) -> float | None:
    degrees = _reading(value, limits)
    return None if degrees is None else math.radians(degrees)


_WRAP = 1 << 32


@dataclass(slots=True)
class PingSequence:
    """Counts lost, duplicate and restarted pings of one sonar by their ids.

    Attributes:
        lost_pings: missing ids.
        duplicates: ids received twice in a row.
        restarts: steps back, as after power-up.
    """

    lost_pings: int = 0
    duplicates: int = 0
    restarts: int = 0
    _last: int | None = None

    def state(self) -> tuple[int, int, int, int | None]:
        """Return the counts and the last id, for `restore`."""
        return self.lost_pings, self.duplicates, self.restarts, self._last

    def restore(self, state: tuple[int, int, int, int | None]) -> None:
        """Continue as the sequence of which `state` was taken."""
        self.lost_pings, self.duplicates, self.restarts, self._last = state

    def accept(self, ping_id: int) -> bool:
        """Add the next id. Return False if it repeats the previous one."""
        last, self._last = self._last, ping_id
        if last is None:
            return True
        step = (ping_id - last) % _WRAP
        if step == 0:
            self.duplicates += 1
            return False
        if step < _WRAP // 2:
            self.lost_pings += step - 1
        else:
            self.restarts += 1
        return True

    def restart(self) -> None:
        """Count a restart detected by other means; the next id does not continue the sequence."""
        self.restarts += 1
        self._last = None


_YEAR_2000_NS: Final = 946_684_800_000_000_000


def caption_lines(ping: Ping) -> list[str]:
    """Return ASCII lines for a picture: the ping, its settings, and its arrival time.

    The time is omitted if the arrival stamp is not a date: stamps of a live sonar count from the
    start of the host.
    """
    what = [f"ping {ping.ping_id}", f"{ping.rows} rows x {ping.beams} beams"]
    what.append(f"{ping.bits_per_sample} bit")
    how = [f"range {ping.max_range_m:.2f} m", f"mode {ping.mode}"]
    if not math.isnan(ping.frequency_hz):
        how.append(f"{ping.frequency_hz / 1e6:.3f} MHz")
    if not math.isnan(ping.gain_percent):
        how.append(f"gain {ping.gain_percent:.0f} %")
    how.append(f"sound {ping.speed_of_sound_mps:.1f} m/s")
    lines = ["   ".join(what), "   ".join(how)]
    if ping.arrival_ns is not None and ping.arrival_ns >= _YEAR_2000_NS:
        lines.append(format_time(ping.arrival_ns))
    return lines


def format_time(unix_ns: int) -> str:
    """Return the time as UTC text with milliseconds, or as a number if it is not a valid date."""
    try:
        moment = datetime.fromtimestamp(unix_ns // 1_000_000_000, UTC)
    except (OverflowError, ValueError, OSError):
        return f"{unix_ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{unix_ns // 1_000_000 % 1000:03d} UTC"
