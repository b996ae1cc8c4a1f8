"""NMEA 0183 of a USBL or surface receiver and a gyro: GGA, RMC, VTG; HDT, PRDID, PASHR."""

import math
from datetime import UTC, datetime
from functools import reduce
from operator import xor

from sonar_sim.navigation.fix import Fix, RateLimiter

POSITION_S = 1.0
"""Between position fixes; the gyro's sentences come with every fix."""

KNOTS_A_MPS = 3600.0 / 1852.0
KMH_A_MPS = 3.6
RTK_FIX = 4
SATELLITES = 12
HDOP = 0.8


class Nmea:
    """Sentences of one receiver and one gyro."""

    def __init__(self) -> None:
        self._position = RateLimiter(POSITION_S)

    def encode(self, fix: Fix) -> list[bytes]:
        """Return the sentences that are due, each with its CR LF."""
        sent = [_hdt(fix), _prdid(fix), _pashr(fix)]
        if self._position.due(fix.boot_s):
            sent += [_gga(fix), _rmc(fix), _vtg(fix)]
        return sent


def sentence(*fields: str) -> bytes:
    """A sentence with its checksum: all characters between $ and * in one xor."""
    text = ",".join(fields)
    return f"${text}*{reduce(xor, text.encode('ascii'), 0):02X}\r\n".encode("ascii")


def _gga(fix: Fix) -> bytes:
    height_m = -float(fix.position_ned_m[2])
    quality = (str(RTK_FIX), str(SATELLITES), f"{HDOP:.1f}")
    return sentence(
        "GPGGA", _time(fix), *_place(fix), *quality, f"{height_m:.3f}", "M", "0.0", "M", "", ""
    )


def _rmc(fix: Fix) -> bytes:
    course_deg, speed_mps = _course(fix)
    date = _utc(fix).strftime("%d%m%y")
    knots = f"{KNOTS_A_MPS * speed_mps:.3f}"
    return sentence(
        "GPRMC", _time(fix), "A", *_place(fix), knots, f"{course_deg:.2f}", date, "", "", "A"
    )


def _vtg(fix: Fix) -> bytes:
    course_deg, speed_mps = _course(fix)
    knots, kmh = f"{KNOTS_A_MPS * speed_mps:.3f}", f"{KMH_A_MPS * speed_mps:.3f}"
    return sentence("GPVTG", f"{course_deg:.2f}", "T", "", "M", knots, "N", kmh, "K", "A")


def _hdt(fix: Fix) -> bytes:
    return sentence("GPHDT", f"{_rounded_heading_deg(fix):.2f}", "T")


def _prdid(fix: Fix) -> bytes:
    """Pitch, roll and heading, in this order."""
    roll, pitch, _ = (math.degrees(angle) for angle in fix.roll_pitch_yaw_rad)
    return sentence("PRDID", f"{pitch:.2f}", f"{roll:.2f}", f"{_rounded_heading_deg(fix):.2f}")


def _pashr(fix: Fix) -> bytes:
    """Heading, roll, pitch and heave, then their accuracies."""
    roll, pitch, _ = (math.degrees(angle) for angle in fix.roll_pitch_yaw_rad)
    heave_m = -float(fix.position_ned_m[2])
    noise = f"{fix.errors.attitude_noise_deg:.3f}"
    heading = (f"{_rounded_heading_deg(fix):.2f}", "T")
    tilt = (f"{roll:+.2f}", f"{pitch:+.2f}", f"{heave_m:+.2f}")
    return sentence("PASHR", _time(fix), *heading, *tilt, noise, noise, noise, "1", "1")


def _rounded_heading_deg(fix: Fix) -> float:
    """With two decimals, 0 to 359.99: 360.00 is not a heading."""
    return round(fix.heading_deg, 2) % 360.0


def _course(fix: Fix) -> tuple[float, float]:
    """Course over ground in degrees, and speed."""
    north_mps, east_mps, _ = (float(part) for part in fix.velocity_ned_mps)
    course_deg = round(math.degrees(math.atan2(east_mps, north_mps)) % 360.0, 2) % 360.0
    return course_deg, math.hypot(north_mps, east_mps)


def _place(fix: Fix) -> tuple[str, str, str, str]:
    """Latitude and longitude in degrees and minutes; seven decimals are 0.2 mm."""
    latitude_deg, longitude_deg = fix.latitude_longitude_deg
    return (
        _degrees_minutes(latitude_deg, 2),
        "N" if latitude_deg >= 0.0 else "S",
        _degrees_minutes(longitude_deg, 3),
        "E" if longitude_deg >= 0.0 else "W",
    )


def _degrees_minutes(angle_deg: float, digits: int) -> str:
    minutes_e7 = round(abs(angle_deg) * 60.0 * 1e7)  # whole, so that 60.0000000 cannot come out
    degrees, rest = divmod(minutes_e7, 60 * 10**7)
    return f"{degrees:0{digits}d}{rest / 1e7:010.7f}"


def _utc(fix: Fix) -> datetime:
    return datetime.fromtimestamp(fix.valid_ns // 10**7 / 100, UTC)


def _time(fix: Fix) -> str:
    """Hours, minutes and seconds of the fix's validity, to a hundredth."""
    hundredths = fix.valid_ns // 10**7
    whole = datetime.fromtimestamp(hundredths // 100, UTC)
    return f"{whole:%H%M%S}.{hundredths % 100:02d}"
