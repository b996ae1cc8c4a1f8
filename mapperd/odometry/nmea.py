"""NMEA 0183: GGA and RMC (place), VTG (course), HDT (heading), PRDID, PASHR (attitude).

pynmea2 splits sentences; numbers are parsed here, strictly: an empty field is unknown, not 0.
Angles of PRDID and PASHR are those of the vehicle: pitch nose up, roll starboard down, heading
clockwise from true north.
"""

import math
import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import pynmea2
from numpy.typing import NDArray
from pynmea2.types.proprietary.ash import ASHRATT
from pynmea2.types.proprietary.rdi import RDID

from mapperd.errors import Reject
from mapperd.geometry.frames import compass_quaternion, compass_to_map
from mapperd.odometry.clock import Leaders, Precedence
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.records import MAX_SPEED_MPS, Clock, GeoPoint, Odometry

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["MAX_LINE_BYTES", "NmeaReader", "UtcDay"]

FIRST_YEAR, LAST_YEAR = 1980, 2199  # years of satellite navigation, and of 64-bit nanoseconds
DAY_NS = 86_400 * 10**9
UNIX_FROM_NS = 10**18
"""Host stamps from 2001 on are Unix time; smaller ones count from another origin."""

_TIME = re.compile(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d|60)(?:\.(\d{0,9})\d*)?")


class UtcDay:
    """Notes the sender's last date, and the last stamp made from it."""

    def __init__(self) -> None:
        self._midnight_ns: int | None = None
        self._last_ns: int | None = None

    def state(self) -> tuple[int | None, int | None]:
        """Return midnight of the last date, and the last stamp."""
        return self._midnight_ns, self._last_ns

    def restore(self, midnight_ns: int | None, last_ns: int | None) -> None:
        """Restore a state that `state` returned."""
        self._midnight_ns, self._last_ns = midnight_ns, last_ns

    def learn(self, day: str, month: str, year: str) -> None:
        """Note a date in digits.

        Raises:
            ValueError: the date does not exist.
        """
        if not FIRST_YEAR <= int(year) <= LAST_YEAR:
            raise ValueError(f"the year {year[:20]} is not ours")
        midnight = datetime(int(year), int(month), int(day), tzinfo=UTC)
        midnight_ns = round(midnight.timestamp()) * 10**9
        if midnight_ns != self._midnight_ns:
            self._midnight_ns, self._last_ns = midnight_ns, None

    def stamp(self, text: str, arrival_ns: int | None) -> tuple[int, Clock]:
        """Return stamp and clock of a time of day; (0, "arrival") if unknown.

        Args:
            text: hhmmss or hhmmss.ss, or nothing.
            arrival_ns: arrival of the sentence, host clock.

        Raises:
            ValueError: the text is not a time of day.
        """
        if not text:
            return 0, "arrival"
        match = _TIME.fullmatch(text)
        if match is None:
            raise ValueError(f"{text[:20]!r} is no time of day")
        seconds = 3600 * int(match[1]) + 60 * int(match[2]) + int(match[3])
        of_day_ns = seconds * 10**9 + int((match[4] or "").ljust(9, "0"))
        if self._midnight_ns is not None:
            stamp_ns = self._midnight_ns + of_day_ns
            # The date is sent less often than the time: midnight may have passed since.
            self._last_ns = _nearest(stamp_ns, self._last_ns or stamp_ns)
            return self._last_ns, "unix"
        if arrival_ns is not None and arrival_ns >= UNIX_FROM_NS:
            return _nearest(of_day_ns, arrival_ns), "unix"
        return 0, "arrival"


def _nearest(stamp_ns: int, near_ns: int) -> int:
    """Return the stamp, moved by whole days to be nearest to the other one."""
    return stamp_ns + round((near_ns - stamp_ns) / DAY_NS) * DAY_NS


MAX_LINE_BYTES = 512
"""Maximum length of a line; the standard allows 82 bytes, but longer lines exist."""

ORDER = ("PASHR", "PRDID", "GGA", "RMC", "VTG", "HDT")
"""Sentences with the same quantity, best first."""

SOURCE = "nmea"
KNOT_MPS = 1852 / 3600
KMH_MPS = 1 / 3.6
MAX_ALTITUDE_M = 20e3

# pynmea2 raises its own errors (all ValueErrors) and some of Python's.
_PYNMEA2_ERRORS = (ValueError, IndexError, KeyError, TypeError, AttributeError)
_NUMBER = re.compile(r"[+-]?\d{1,12}(\.\d{0,12})?|[+-]?\.\d{1,12}")
_ANGLE = re.compile(r"(\d{2,3})(\d{2}(?:\.\d{0,12})?)")

Fields = dict[str, str]
Floats = NDArray[np.float64]


class _NoFixError(ValueError):
    """Whether the receiver reports no fix."""


class _NmeaState(NamedTuple):
    midnight_ns: int | None
    last_ns: int | None
    leaders: Leaders


class NmeaReader:
    """Decodes sentences of one link; notes the date."""

    def __init__(self) -> None:
        self._day = UtcDay()
        self._precedence = Precedence(ORDER)
        self._readers: dict[str, Callable[[Fields, int | None], Odometry]] = {
            "GGA": self._gga,
            "RMC": self._rmc,
            "VTG": _vtg,
            "HDT": _hdt,
            "PRDID": _prdid,
            "PASHR": self._pashr,
        }

    def state(self) -> _NmeaState:
        """As `Decoder.state`."""
        return _NmeaState(*self._day.state(), self._precedence.state())

    def restore(self, state: Any) -> None:  # noqa: ANN401 as read from a checkpoint
        """As `Decoder.restore`."""
        midnight_ns, last_ns, leaders = msgspec.convert(state, _NmeaState, strict=False)
        self._day.restore(midnight_ns, last_ns)
        self._precedence.restore(leaders)

    def __call__(
        self, line: bytes, arrival_ns: int | None, counters: DecoderCounters
    ) -> Odometry | Reject | None:
        """Read one line."""
        text = line.decode("latin-1")
        text = text[max(text.rfind("$"), 0) :].rstrip()
        if not text.startswith("$"):
            return Reject("not_a_sentence", f"{len(line)} bytes without a $")
        try:
            # Some devices write the checksum in lower case, which the parser rejects.
            sentence: Any = pynmea2.parse(text[:-2] + text[-2:].upper(), check=True)
        except pynmea2.ChecksumError:
            return Reject("bad_checksum", f"{text[:6]}: the check is missing or wrong")
        except pynmea2.SentenceTypeError:
            counters.heard("other", len(line))
            counters.ignore("other")
            return None
        except _PYNMEA2_ERRORS as error:
            return Reject("not_a_sentence", f"cannot be taken apart ({type(error).__name__})")
        return self._read(sentence, len(line), arrival_ns, counters)

    def _read(
        self,
        sentence: Any,  # noqa: ANN401 pynmea2 has no types
        size: int,
        arrival_ns: int | None,
        counters: DecoderCounters,
    ) -> Odometry | Reject | None:
        name = _name(sentence)
        counters.heard(name, size)
        fields = {
            names[1]: value for names, value in zip(sentence.fields, sentence.data, strict=False)
        }
        reader = self._readers.get(name)
        if reader is None and name != "ZDA":
            counters.ignore(name)
            return None
        try:
            if reader is not None:
                odometry = reader(fields, arrival_ns)
                odometry_or_less = self._precedence.filtered(name, odometry, arrival_ns)
                if odometry_or_less is None:
                    counters.ignore("superseded")
                return odometry_or_less
            self._day.learn(fields["day"], fields["month"], fields["year"])
        except _NoFixError as error:
            return Reject("no_fix", f"{name}: {error}")
        except (ValueError, KeyError) as error:
            return Reject("wrong_shape", f"{name}: {error}")
        return None

    def _gga(self, fields: Fields, arrival_ns: int | None) -> Odometry:
        if fields["gps_qual"] in ("", "0"):
            raise _NoFixError("quality 0")
        altitude = fields["altitude"]
        if altitude and fields["altitude_units"] != "M":
            raise ValueError("the altitude is not in metres")
        altitude_m = _limited(altitude, MAX_ALTITUDE_M) if altitude else None
        geo = GeoPoint(*_place(fields), altitude_m)
        stamp_ns, clock = self._day.stamp(fields["timestamp"], arrival_ns)
        return Odometry(stamp_ns, clock, source=SOURCE, geo=geo)

    def _rmc(self, fields: Fields, arrival_ns: int | None) -> Odometry:
        if fields["status"] != "A":
            raise _NoFixError("status is not A")
        if date := fields["datestamp"]:
            self._day.learn(date[:2], date[2:4], "20" + date[4:])
        geo = GeoPoint(*_place(fields), None)
        velocity = None
        if fields["spd_over_grnd"] and fields["true_course"]:
            speed_mps = _limited(fields["spd_over_grnd"], MAX_SPEED_MPS / KNOT_MPS) * KNOT_MPS
            velocity = _along(fields["true_course"], speed_mps)
        stamp_ns, clock = self._day.stamp(fields["timestamp"], arrival_ns)
        return Odometry(stamp_ns, clock, source=SOURCE, geo=geo, velocity_east_north_mps=velocity)

    def _pashr(self, fields: Fields, arrival_ns: int | None) -> Odometry:
        if fields["is_true_heading"] != "T":
            raise ValueError("the heading is not true")
        stamp_ns, clock = self._day.stamp(fields["timestamp"], arrival_ns)
        quaternion = _attitude(fields["roll"], fields["pitch"], fields["true_heading"])
        return Odometry(stamp_ns, clock, source=SOURCE, map_q_base=quaternion)


def _vtg(fields: Fields, _arrival_ns: int | None) -> Odometry:
    if not fields["true_track"]:  # undefined at rest
        raise _NoFixError("no course")
    if knots := fields["spd_over_grnd_kts"]:
        speed_mps = _limited(knots, MAX_SPEED_MPS / KNOT_MPS) * KNOT_MPS
    else:
        speed_mps = _limited(fields["spd_over_grnd_kmph"], MAX_SPEED_MPS / KMH_MPS) * KMH_MPS
    velocity = _along(fields["true_track"], speed_mps)
    return Odometry(0, "arrival", source=SOURCE, velocity_east_north_mps=velocity)


def _hdt(fields: Fields, _arrival_ns: int | None) -> Odometry:
    heading_rad = compass_to_map(_limited(fields["heading"], 360))
    return Odometry(0, "arrival", source=SOURCE, heading_rad=heading_rad)


def _prdid(fields: Fields, _arrival_ns: int | None) -> Odometry:
    quaternion = _attitude(fields["roll"], fields["pitch"], fields["heading"])
    return Odometry(0, "arrival", source=SOURCE, map_q_base=quaternion)


def _attitude(roll: str, pitch: str, heading: str) -> Floats:
    return compass_quaternion(_limited(roll, 180), _limited(pitch, 90), _limited(heading, 360))


def _along(course: str, speed_mps: float) -> Floats:
    """Return east and north components of a speed along a compass course."""
    angle_rad = compass_to_map(_limited(course, 360))
    return np.array([speed_mps * math.cos(angle_rad), speed_mps * math.sin(angle_rad)])


def _place(fields: Fields) -> tuple[float, float]:
    """Return latitude and longitude in radians."""
    latitude = _angle(fields["lat"], 2, 90) * _sign(fields["lat_dir"], "NS")
    longitude = _angle(fields["lon"], 3, 180) * _sign(fields["lon_dir"], "EW")
    return latitude, longitude


def _angle(text: str, digits: int, max_deg: float) -> float:
    """Return radians of degrees (so many digits) and minutes written as one number."""
    match = _ANGLE.fullmatch(text)
    if match is None or len(match[1]) != digits:
        raise ValueError(f"{text[:20]!r} is not an angle")
    minutes = float(match[2])
    degrees = int(match[1]) + minutes / 60
    if minutes >= 60 or degrees > max_deg:  # noqa: PLR2004 minutes
        raise ValueError(f"{text[:20]!r} is not an angle")
    return math.radians(degrees)


def _sign(text: str, letters: str) -> float:
    if len(text) != 1 or text not in letters:
        raise ValueError(f"{text[:20]!r} where {letters[0]} or {letters[1]} was expected")
    return 1.0 if text == letters[0] else -1.0


def _limited(text: str, limit: float) -> float:
    """Parse a plain decimal number between -limit and limit."""
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"{text[:20]!r} is not a number")
    number = float(text)
    if abs(number) > limit:
        raise ValueError(f"{number:g} is beyond {limit:g}")
    return number


def _name(sentence: Any) -> str:  # noqa: ANN401 pynmea2 has no types
    """Return the kind of a sentence: GGA for a talker, PRDID or PASHR for a maker."""
    if isinstance(sentence, pynmea2.TalkerSentence):
        return str(sentence.sentence_type)
    if isinstance(sentence, RDID):
        return "PRDID"
    return "PASHR" if isinstance(sentence, ASHRATT) else "other"
