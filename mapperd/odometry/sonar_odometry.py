"""Sonar odometry: the vehicle's horizontal motion from consecutive pings.

A ping is registered to a keyframe, an earlier ping of the same place. Both polar images are freed
of what moves with the vehicle, laid on the horizontal plane by attitude and mounting, and compared
by correlation in the frequency domain (Hurtós, Ribas, Cufí, Petillot, Salvi: Fourier-based
registration for robust forward-looking sonar mosaicing in low-visibility underwater environments,
Journal of Field Robotics 32(1), 2015). The rotation comes from the attitude; without one it is
searched.

The sonar does not measure the elevation e of an echo. Bearings count as from the upper edge of the
beam, where walls, piles and the far floor are. Slant ranges count as horizontal: those to a wall,
which is seen by the edge of the beam, change by 1 / cos(e) of the way, those to a point of the
floor by cos(e).
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import SonarOdometryConfig
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.geometry.frames import pose_from_rpy, quaternion_to_matrix, rotation_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.odometry.records import Odometry, linear_covariance

__all__ = ["GroundMotion", "SonarOdometry", "SonarOdometryState", "sonar_odometry"]

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

CELLS = 160
"""Cells of the plane over the range: 12 cm at 20 m, resolved to about a tenth."""

BACKGROUND_HALF_WIDTH = 12
"""Half width, in rows and beams, of the surroundings that a sample is compared with."""

MIN_CONTRAST = 1.0
"""A sample counts from so many standard deviations above its surroundings."""

WHITENING = 0.7
"""Exponent of the spectrum's amplitude that is divided out; 1 is phase correlation."""

SMOOTHING = 0.12
"""Standard deviation of the low pass, cycles per cell."""

BLOCKS = (12, 22)
"""Sub-images along and across, whose agreement gives the covariance."""

MIN_BLOCKS = 2.5
"""Minimum effective number of sub-images that contribute: one target alone may be another one."""

MIN_PEAK, MIN_FIRST_PEAK = 7.0, 12.0
"""Minimum height of the peak over the surface's standard deviation; noise reaches 5.

The second one holds after silence, where the search is wide.
"""

MAX_SIDE_PEAK = 0.75
"""Maximum height of another peak within reach, as a share of the highest."""

PEAK_CELLS = 4
"""Half width of a peak: beyond it, another maximum is another peak."""

MAX_STD = 0.006
"""Maximum standard deviation of a registration, as a share of the range: 12 cm at 20 m."""

KEY_SHIFT, KEY_TURN_RAD = 0.06, math.radians(12.0)
"""A keyframe serves up to this shift, as a share of the range, and this turn."""

KEY_AGE_NS = 1_000_000_000
"""After so long without a registration the next ping becomes the keyframe."""

MAX_DEPRESSION_RAD = math.radians(45.0)
"""A sonar that looks down farther sees no horizontal plane."""

ACCELERATION_MPS2, SPEED_CHANGE_MPS = 0.3, 0.2
"""Maximum change of a known velocity: with time, and at once."""

SCALE_STD = 0.02
"""Standard deviation of the scale, as the elevation of the echoes is unknown."""

YAW_STEP_RAD, YAW_STEPS = math.radians(1.0), 5
"""Without attitude: step and number of tried turns to each side of the expected one."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotion:
    """Mean motion of the base between two pings.

    Attributes:
        from_ns, to_ns: times of the pings.
        velocity_mps: (2,) surge (forward) and sway (to port), horizontal, along the heading in the
            middle of the interval.
        yaw_rate_radps: positive to port.
        covariance: (3, 3) of surge, sway and yaw rate; of the latter 0 if the attitude gave it.
        yaw_rad: heading in the middle of the interval, from the map's x axis to port; where no
            attitude is known, from the heading of the first ping.
        peak: height of the correlation's peak over its noise.
    """

    from_ns: int
    to_ns: int
    velocity_mps: Floats
    yaw_rate_radps: float
    covariance: Floats
    yaw_rad: float
    peak: float

    def records(self, steps: int, *, heading: bool = False) -> list[Odometry]:
        """Return the motion as velocities over ground, in the middle of equal parts.

        The vertical part is not measured; its variance repeats the larger horizontal one.

        Args:
            steps: number of records.
            heading: with the attitude: level, with the measured yaw.
        """
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        surge, sway = self.velocity_mps.tolist()
        worst = max(self.covariance[0, 0], self.covariance[1, 1])
        linear = np.zeros((3, 3))
        linear[:2, :2], linear[2, 2] = self.covariance[:2, :2], worst
        found = []
        for k in range(steps):
            share = (k + 0.5) / steps
            span_ns = self.to_ns - self.from_ns
            yaw = self.yaw_rad + (share - 0.5) * span_ns / 1e9 * self.yaw_rate_radps
            turn = rotation_from_rpy(0.0, 0.0, math.degrees(yaw)) if heading else None
            found.append(
                Odometry(
                    stamp_ns=self.from_ns + round(share * span_ns),
                    clock="unix",
                    map_q_base=turn,
                    velocity_east_north_mps=np.array(
                        [cos * surge - sin * sway, sin * surge + cos * sway]
                    ),
                    twist_covariance=linear_covariance(linear),
                    north_referenced=not heading,
                )
            )
        return found


class LevelPing(NamedTuple):
    """A ping in level axes: the keyframe, or one that is compared with it.

    Attributes:
        image: (rows, beams) float32, cleaned polar image.
        bearings_rad: (beams,).
        row_m: thickness of a row.
        tilt: (3, 3) sonar in level axes along its own heading.
        yaw_rad: heading of the base.
        sonar_yaw_rad: heading of the sonar.
    """

    image: Image
    bearings_rad: Floats
    row_m: float
    tilt: Floats
    yaw_rad: float
    sonar_yaw_rad: float


class LastRegistration(NamedTuple):
    """The last registered ping, relative to the keyframe.

    Attributes:
        t_ns: its time.
        shift_m: (2,) of the base since the keyframe, along the sonar's heading then.
        covariance_m2: (2, 2) of that, without the scale's.
        yaw_rad: heading of the base.
        yaw_variance: of its turn since the keyframe.
        arm_m: (2,) horizontal lever arm of the sonar, map axes.
    """

    t_ns: int
    shift_m: Floats
    covariance_m2: Floats
    yaw_rad: float
    yaw_variance: float
    arm_m: Floats


class SonarOdometryState(NamedTuple):
    """State of a `SonarOdometry`.

    Attributes:
        key: the keyframe.
        last: the last registered ping.
        velocity: (2,) map axes, m/s, and yaw rate of the last motion; None after silence.
        newest_ns: time of the newest ping.
        missed: pings since the last one that was registered or became the keyframe.
        motions: number of motions so far.
        silent: number of pings without a motion, by reason.
    """

    key: LevelPing | None
    last: LastRegistration | None
    velocity: tuple[Floats, float] | None
    newest_ns: int | None
    missed: int
    motions: int
    silent: dict[str, int]


class _LevelPlane:
    """The horizontal plane before a sonar, in cells.

    Args:
        bearings_rad: (beams,) of the fan.
        range_m: of the image.
        depression_rad: assumed angle of the echoes below the horizon.
    """

    def __init__(self, bearings_rad: Floats, range_m: float, depression_rad: float) -> None:
        self.cell_m = range_m / CELLS
        half_m = range_m * math.sin(min(float(np.abs(bearings_rad).max()), math.pi / 2))
        # A multiple of 8 is quick to transform.
        self.shape = (CELLS, 8 * math.ceil(2 * half_m / self.cell_m / 8))
        self._forward = (np.arange(self.shape[0]) + 0.5) * self.cell_m
        self._port = (np.arange(self.shape[1]) + 0.5 - self.shape[1] / 2) * self.cell_m
        self._range_m = range_m
        self._gradient = math.tan(depression_rad)
        waves = np.fft.fftfreq(self.shape[0])[:, None], np.fft.rfftfreq(self.shape[1])[None]
        self._low_pass = np.exp(-(waves[0] ** 2 + waves[1] ** 2) / (4 * SMOOTHING**2))

    def seen(
        self, key: LevelPing, tilt: Floats, shift_m: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Return a ping's image on the plane, and each cell's weight.

        Args:
            key: the ping; its own `tilt` is not used.
            tilt: (3, 3) sonar in the axes of the plane.
            shift_m: (2,) position of the sonar on the plane.
        """
        ahead, port = self._forward[:, None], self._port[None, :]
        if shift_m is not None:
            ahead, port = ahead - shift_m[0], port - shift_m[1]
        flat = np.hypot(ahead, port)
        down = -self._gradient * flat
        # Rows of the inverse rotation, written out: a third of the time of a product.
        x = tilt[0, 0] * ahead + tilt[1, 0] * port + tilt[2, 0] * down
        y = tilt[0, 1] * ahead + tilt[1, 1] * port + tilt[2, 1] * down
        bearing = -np.arctan2(y, x)
        row = flat / key.row_m - 0.5
        beams = key.image.shape[1]
        beam = np.interp(bearing, key.bearings_rad, np.arange(beams), left=-1.0, right=-1.0)
        inside = (row >= 0) & (row < len(key.image) - 1) & (beam >= 0) & (beam < beams - 1)
        i = np.where(inside, row, 0).astype(np.intp)
        j = np.where(inside, beam, 0).astype(np.intp)
        f, g = np.where(inside, row - i, 0.0), np.where(inside, beam - j, 0.0)
        samples, k = key.image.ravel(), i * beams + j
        near = (1 - g) * samples[k] + g * samples[k + 1]
        far = (1 - g) * samples[k + beams] + g * samples[k + beams + 1]
        first, last = float(key.bearings_rad[0]), float(key.bearings_rad[-1])
        side = np.minimum(bearing - first, last - bearing) / math.radians(6.0)
        weight = inside * _ramp(side) * _ramp((self._range_m - flat) / (0.08 * self._range_m))
        weight *= _ramp(flat / (0.03 * self._range_m) - 1.0)
        return (1 - f) * near + f * far, weight

    def whitened(self, image: Floats, weight: Floats) -> NDArray[np.complex128]:
        """Return the transform of a weighted image, with its amplitudes evened out."""
        total = float(weight.sum())
        mean = float((image * weight).sum()) / total if total else 0.0
        waves = np.fft.rfft2((image - mean) * weight)
        amplitude = np.abs(waves) ** WHITENING
        return waves * self._low_pass / (amplitude + 0.03 * float(amplitude.mean()) + 1e-12)

    def centre_m(self, image: Floats) -> Floats:
        """Return the middle (2,) of the squares of an image."""
        squares = image * image
        total = float(squares.sum()) + 1e-12
        ahead = float(squares.sum(axis=1) @ self._forward)
        return np.array([ahead, float(squares.sum(axis=0) @ self._port)]) / total

    def picture(self, waves: NDArray[np.complex128]) -> Floats:
        """Return the inverse transform."""
        return np.asarray(np.fft.irfft2(waves, s=self.shape))


class _KeyframeView(NamedTuple):
    """A keyframe on its plane.

    Attributes:
        plane: the plane.
        image, weight: of each cell.
        waves: whitened transform.
        centre_m: (2,) middle of the texture.
    """

    plane: _LevelPlane
    image: Floats
    weight: Floats
    waves: NDArray[np.complex128]
    centre_m: Floats


class _Fit(NamedTuple):
    """A registration to the keyframe, along the sonar's heading then.

    Attributes:
        shift_m, covariance_m2: (2,) and (2, 2) of the sonar.
        turn_rad, turn_variance: correction of the assumed turn; 0 if it was not searched.
        peak: height of the peak over the noise.
    """

    shift_m: Floats
    covariance_m2: Floats
    turn_rad: float
    turn_variance: float
    peak: float


class _Peak(NamedTuple):
    """A maximum of a correlation: its place (2,) in cells, height over noise, and side peak."""

    cells: Floats
    height: float
    side: float


class SonarOdometry:
    """Measures the motion between pings; without input or output.

    Args:
        settings: limits.
        base_T_sonar: (4, 4) rigid transform of the mounting.
        aperture_rad: full vertical aperture of the sonar.

    Attributes:
        motions: number of motions so far.
        silent: number of pings without a motion, by reason.
    """

    def __init__(
        self,
        settings: SonarOdometryConfig,
        base_T_sonar: Floats,  # noqa: N803 frames are named
        aperture_rad: float,
    ) -> None:
        self._settings = settings
        self._aperture_rad = aperture_rad
        self._mount(base_T_sonar)
        self._key: LevelPing | None = None
        self._last: LastRegistration | None = None
        self._velocity: tuple[Floats, float] | None = None
        self._newest_ns: int | None = None
        self._missed = 0
        self._seen: _KeyframeView | None = None
        self.motions = 0
        self.silent: Counter[str] = Counter()

    def state(self) -> SonarOdometryState:
        """Return the state for `restore`."""
        return SonarOdometryState(
            self._key,
            self._last,
            self._velocity,
            self._newest_ns,
            self._missed,
            self.motions,
            dict(self.silent),
        )

    def restore(self, state: SonarOdometryState) -> None:
        """Restore a state taken with the same settings."""
        self._key, self._last, self._velocity = state.key, state.last, state.velocity
        self._newest_ns, self._missed = state.newest_ns, state.missed
        self.motions, self.silent = state.motions, Counter(state.silent)
        self._seen = None

    def reconfigure(self, config: Config) -> None:
        """Use another mounting from now on; a changed one ends the present motion."""
        before = self._base_R_sonar, self._arm_m
        self._mount(_mounting(config))
        if not all(map(np.array_equal, before, (self._base_R_sonar, self._arm_m))):
            self._forget()

    def _mount(self, base_T_sonar: Floats) -> None:  # noqa: N803 frames are named
        self._base_R_sonar = base_T_sonar[:3, :3].copy()
        self._arm_m = base_T_sonar[:3, 3].copy()
        down = float(np.clip(-self._base_R_sonar[2, 0], -1.0, 1.0))
        # The upper edge of the beam, but never above the horizon.
        self._depression_rad = max(0.0, math.asin(down) - self._aperture_rad / 2)

    def take(
        self, ping: PingImage, t_ns: int, map_q_base: Floats | None = None
    ) -> tuple[GroundMotion, int] | Reject:
        """Register a ping.

        Args:
            ping: its image.
            t_ns: its time, later than that of all before.
            map_q_base: (4,) attitude at that time; None if nothing measures it: the vehicle then
                counts as level, and its turns are searched.

        Returns:
            The motion since the last registered ping, and the number of pings since then; or why
            there is none.
        """
        steps = self._missed = self._missed + 1
        result = self._taken(ping, t_ns, map_q_base)
        if isinstance(result, Reject):
            self.silent[result.reason] += 1
            return result
        self.motions += 1
        self._missed = 0
        return result, steps

    def records(
        self, ping: PingImage, t_ns: int, map_q_base: Floats | None = None
    ) -> list[Odometry]:
        """Register a ping, as `take`; return its records, one for each ping since the last motion.

        Several records over an interval keep dead reckoning from taking it for a gap.
        """
        result = self.take(ping, t_ns, map_q_base)
        if isinstance(result, Reject):
            return []
        motion, steps = result
        return motion.records(steps, heading=map_q_base is None)

    def status(self) -> dict[str, Any]:
        """Status for people."""
        return {
            "motions": self.motions,
            "silent": dict(sorted(self.silent.items())),
        }

    def skip(self, problem: Reject) -> None:
        """Count a ping that has no image or no time."""
        self.silent[problem.reason] += 1
        self._missed += 1

    def _taken(self, ping: PingImage, t_ns: int, q: Floats | None) -> GroundMotion | Reject:
        if self._newest_ns is not None and t_ns <= self._newest_ns:
            self._forget()
            self._newest_ns = t_ns
            return Reject("back_in_time", "the ping is not newer than the one before")
        self._newest_ns = t_ns
        if self._depression_rad > MAX_DEPRESSION_RAD:
            return Reject("looks_down", "the sonar sees no horizontal plane: mounting.orientation")
        known = self._key is not None and self._last is not None
        yaw = 0.0
        if q is None and known:
            assert self._last is not None  # noqa: S101 as `known` says
            rate = 0.0 if self._velocity is None else self._velocity[1]
            yaw = self._last.yaw_rad + rate * (t_ns - self._last.t_ns) / 1e9
        frame = self._frame(ping, q, yaw)
        if self._key is None or self._last is None:
            self._rebase(frame, t_ns)
            return Reject("first_ping", "no ping to compare with")
        if not _same_layout(self._key, frame):
            self._rebase(frame, t_ns)
            self._velocity = None
            return Reject("changed_ping", "range, beams or rows of the image changed")
        found = self._registered(frame, t_ns, searching=q is None)
        if isinstance(found, Reject):
            if t_ns - self._last.t_ns > KEY_AGE_NS:
                self._velocity = None
                self._rebase(frame, t_ns)
            return found
        return self._moved(frame, t_ns, found, searched=q is None)

    def _frame(self, ping: PingImage, q: Floats | None, yaw_rad: float) -> LevelPing:
        """Return a ping in level axes; without an attitude the base is level, with this yaw."""
        if q is None:
            base = _turn(yaw_rad)
        else:
            base = quaternion_to_matrix(q)
            yaw_rad = math.atan2(base[1, 0], base[0, 0])
        sonar = base @ self._base_R_sonar
        sonar_yaw = math.atan2(sonar[1, 0], sonar[0, 0])
        image, row_m = _pooled(ping)
        return LevelPing(
            _background_removed(image),
            np.array(ping.bearings_rad),
            row_m,
            _turn(-sonar_yaw) @ sonar,
            yaw_rad,
            sonar_yaw,
        )

    def _arm(self, frame: LevelPing) -> Floats:
        """Return the horizontal lever arm (2,) of the sonar, map axes."""
        arm = _turn(frame.sonar_yaw_rad) @ frame.tilt @ self._base_R_sonar.T @ self._arm_m
        return np.asarray(arm[:2])

    def _forget(self) -> None:
        self._key = self._last = self._velocity = self._seen = None

    def _rebase(self, frame: LevelPing, t_ns: int) -> None:
        """Make a ping the keyframe."""
        self._missed = 0
        self._key, self._seen = frame, None
        self._last = LastRegistration(
            t_ns, np.zeros(2), np.zeros((2, 2)), frame.yaw_rad, 0.0, self._arm(frame)
        )

    def _view(self) -> "_KeyframeView":
        """Return the keyframe on its plane."""
        key = self._key
        assert key is not None  # noqa: S101 only called with one
        if self._seen is None:
            range_m = len(key.image) * key.row_m
            plane = _LevelPlane(key.bearings_rad, range_m, self._depression_rad)
            image, weight = plane.seen(key, key.tilt)
            waves, centre_m = plane.whitened(image, weight), plane.centre_m(image * weight)
            self._seen = _KeyframeView(plane, image, weight, waves, centre_m)
        return self._seen

    def _registered(self, frame: LevelPing, t_ns: int, *, searching: bool) -> "_Fit | Reject":
        """Register a ping to the keyframe; where no attitude is known, search its turn too."""
        key, last = self._key, self._last
        assert key is not None  # noqa: S101 only called with one
        assert last is not None  # noqa: S101
        view = self._view()
        plane = view.plane
        follows = self._velocity is not None and self._missed == 1
        least = MIN_PEAK if follows else MIN_FIRST_PEAK
        tilt = _turn(frame.sonar_yaw_rad - key.sonar_yaw_rad) @ frame.tilt
        window = self._window(frame, (t_ns - last.t_ns) / 1e9, plane.cell_m)
        steps = range(-YAW_STEPS, YAW_STEPS + 1) if searching else (0,)
        turns_rad = [step * YAW_STEP_RAD for step in steps]
        peak, turn_rad = _best(view, frame, tilt, turns_rad, window)
        if peak is None or peak.height < least:
            return Reject("no_texture", "nothing stands out in both images")
        if peak.side > MAX_SIDE_PEAK:
            return Reject("ambiguous", "two shifts explain the images about as well")
        shift_m = peak.cells * plane.cell_m
        turn_variance, arm_m = 0.0, np.zeros(2)
        if searching:
            found = _turned(view, frame, tilt, turn_rad, shift_m)
            if found is None:
                return Reject("ambiguous", "no turn explains the images best")
            turn_rad, turn_variance, shift_m = found
            arm_m = view.centre_m - shift_m
        # Aligned, both images show the same part of the scene under the same weight: the edges of
        # the fan, which move with the sonar, no longer pull the shift to zero.
        blocks, height = _agreement(view, *plane.seen(frame, _turn(turn_rad) @ tilt, shift_m))
        fitted = _fitted(blocks)
        if fitted is None or height < least:
            return Reject("no_texture", "the aligned images do not agree")
        shift_m = shift_m + fitted[0] * plane.cell_m
        # A turn that is too large swings the sonar about the middle of the texture.
        swing_m = np.array([-arm_m[1], arm_m[0]])
        swung_m2 = turn_variance * np.outer(swing_m, swing_m)
        covariance_m2 = fitted[1] * plane.cell_m**2 + swung_m2
        limit_m = MAX_STD * CELLS * plane.cell_m
        if float(np.linalg.eigvalsh(covariance_m2)[-1]) > limit_m**2:
            return Reject("uncertain", "parts of the images disagree, or lack texture one way")
        return _Fit(shift_m, covariance_m2, turn_rad, turn_variance, height)

    def _window(self, frame: LevelPing, seconds: float, cell_m: float) -> tuple[Floats, int]:
        """Return where the sonar should be since the keyframe (2,), and how far off; cells."""
        key, last = self._key, self._last
        assert key is not None  # noqa: S101 only called with one
        assert last is not None  # noqa: S101
        to_key = _turn(-key.sonar_yaw_rad)[:2, :2]
        expected_m = last.shift_m + to_key @ (self._arm(frame) - self._arm(key))
        reach_m = self._settings.max_speed * seconds
        if self._velocity is not None:
            expected_m = expected_m + to_key @ self._velocity[0] * seconds
            reach_m = min(reach_m, (SPEED_CHANGE_MPS + ACCELERATION_MPS2 * seconds) * seconds)
        return expected_m / cell_m, math.ceil(reach_m / cell_m) + 1

    def _moved(self, frame: LevelPing, t_ns: int, fit: "_Fit", *, searched: bool) -> GroundMotion:
        """Return the motion since the last ping, and make this one the last, or the keyframe."""
        key, last = self._key, self._last
        assert key is not None  # noqa: S101 only called with one
        assert last is not None  # noqa: S101
        if searched:
            frame = frame._replace(
                yaw_rad=frame.yaw_rad + fit.turn_rad,
                sonar_yaw_rad=frame.sonar_yaw_rad + fit.turn_rad,
            )
        from_key = _turn(key.sonar_yaw_rad)[:2, :2]
        arm = self._arm(frame)
        base_m = fit.shift_m - from_key.T @ (arm - self._arm(key))
        seconds = (t_ns - last.t_ns) / 1e9
        way = from_key @ (base_m - last.shift_m)
        turn = math.remainder(frame.yaw_rad - last.yaw_rad, math.tau)
        yaw = last.yaw_rad + turn / 2
        to_level = _turn(-yaw)[:2, :2]
        velocity = to_level @ way / seconds
        axes = to_level @ from_key
        noise = axes @ (fit.covariance_m2 + last.covariance_m2) @ axes.T / seconds**2
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = noise + SCALE_STD**2 * float(velocity @ velocity) * np.eye(2)
        covariance[2, 2] = (fit.turn_variance + last.yaw_variance) / seconds**2
        motion = GroundMotion(last.t_ns, t_ns, velocity, turn / seconds, covariance, yaw, fit.peak)
        self._velocity = way / seconds, turn / seconds
        self._last = LastRegistration(
            t_ns, base_m, fit.covariance_m2, frame.yaw_rad, fit.turn_variance, arm
        )
        far = float(np.hypot(*fit.shift_m)) > KEY_SHIFT * len(key.image) * key.row_m
        if far or abs(math.remainder(frame.yaw_rad - key.yaw_rad, math.tau)) > KEY_TURN_RAD:
            self._rebase(frame, t_ns)
        return motion


def sonar_odometry(config: Config) -> SonarOdometry | None:
    """Return the sonar odometry of the settings; None if it is off."""
    if not config.odometry.sonar.enabled:
        return None
    aperture_rad = math.radians(config.sonar.vertical_aperture)
    return SonarOdometry(config.odometry.sonar, _mounting(config), aperture_rad)


def _mounting(config: Config) -> Floats:
    """Return `base_T_sonar` of the settings, (4, 4) rigid transform."""
    position, angles = config.mounting.position, config.mounting.orientation
    return pose_from_rpy(
        (position.x, position.y, position.z), (angles.roll, angles.pitch, angles.yaw)
    ).map_T_base


def _turn(yaw_rad: float) -> Floats:
    """Rotation (3, 3) about the vertical."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _ramp(share: Floats) -> Floats:
    """Return a smooth step from 0 at 0 to 1 at 1."""
    return np.asarray(np.sin(0.5 * math.pi * np.clip(share, 0.0, 1.0)) ** 2)


def _same_layout(key: LevelPing, frame: LevelPing) -> bool:
    return (
        key.image.shape == frame.image.shape
        and key.row_m == frame.row_m
        and np.array_equal(key.bearings_rad, frame.bearings_rad)
    )


def _pooled(ping: PingImage) -> tuple[Image, float]:
    """Return the mean of neighbouring rows, about one a cell, and their thickness."""
    pool = max(1, len(ping.intensity) // CELLS)
    rows = len(ping.intensity) // pool
    pooled = ping.intensity[: rows * pool].reshape(rows, pool, -1).mean(axis=1, dtype=np.float32)
    return pooled, pool * ping.range_resolution_m


def _background_removed(image: Image) -> Image:
    """Return what stands out of its surroundings, in their standard deviations.

    The median over all beams takes out what depends on the range alone: the line below the
    vehicle, steps of the gain, side lobes. The mean of the surroundings takes out what is wide: the
    beam's footprint on the floor. Both move with the vehicle.
    """
    image = image - np.median(image, axis=1, keepdims=True)
    above = image - _local_mean(image)
    deviation = np.sqrt(_local_mean(above * above))
    floor = 0.5 * float(np.median(deviation)) + 0.2
    strength = np.log1p(np.maximum(above / np.maximum(deviation, floor) - MIN_CONTRAST, 0.0))
    return np.asarray(strength - _local_mean(strength), dtype=np.float32)


def _local_mean(image: NDArray[np.floating]) -> Floats:
    """Return the mean over a box about each sample, edges repeated."""
    mean = np.asarray(image, dtype=np.float64)
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (BACKGROUND_HALF_WIDTH + 1, BACKGROUND_HALF_WIDTH)
        sums = np.cumsum(np.pad(mean, margin, mode="edge"), axis=axis)
        places = np.arange(mean.shape[axis])
        upper = np.take(sums, places + 2 * BACKGROUND_HALF_WIDTH + 1, axis=axis)
        mean = (upper - np.take(sums, places, axis=axis)) / (2 * BACKGROUND_HALF_WIDTH + 1)
    return mean


def _peak(surface: Floats, expected: Floats, reach: int) -> _Peak | None:
    """Return the highest place within reach; None if it lies on the edge of it.

    Args:
        surface: correlation; periodic, zero shift at 0, 0.
        expected: (2,) cells.
        reach: cells to each side.
    """
    rows = np.arange(-reach, reach + 1) + round(float(expected[0]))
    columns = np.arange(-reach, reach + 1) + round(float(expected[1]))
    part = surface[np.ix_(rows % surface.shape[0], columns % surface.shape[1])]
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(part)), part.shape))
    spread = float(surface.std())
    if not (0 < i < 2 * reach and 0 < j < 2 * reach) or spread <= 0:
        return None
    height = float(part[i, j])
    others = part.copy()
    others[
        max(i - PEAK_CELLS, 0) : i + PEAK_CELLS + 1, max(j - PEAK_CELLS, 0) : j + PEAK_CELLS + 1
    ] = 0.0
    side = float(others.max()) / height
    return _Peak(np.array([rows[i], columns[j]], dtype=np.float64), height / spread, side)


def _best(
    view: _KeyframeView,
    frame: LevelPing,
    tilt: Floats,
    turns_rad: list[float],
    window: tuple[Floats, int],
) -> tuple[_Peak | None, float]:
    """Return the highest peak over some turns of a ping, and its turn.

    Args:
        view: the keyframe.
        frame: the ping.
        tilt: (3, 3) its sonar in the axes of the plane, before the turn.
        turns_rad: turns to try.
        window: where the peak may lie, as for `_peak`.
    """
    best: _Peak | None = None
    at_rad = 0.0
    for turn_rad in turns_rad:
        waves = view.plane.whitened(*view.plane.seen(frame, _turn(turn_rad) @ tilt))
        # The scene moves against the sonar: this order has its peak at the motion of the sonar.
        found = _peak(view.plane.picture(waves.conj() * view.waves), *window)
        if found is not None and (best is None or found.height > best.height):
            best, at_rad = found, turn_rad
    return best, at_rad


def _turned(
    view: _KeyframeView, frame: LevelPing, tilt: Floats, turn_rad: float, shift_m: Floats
) -> tuple[float, float, Floats] | None:
    """Fit a parabola to the agreement over the turn, about the middle of the texture.

    Returns:
        The turn with the highest agreement, its variance, and the shift (2,) that goes with it;
        None if there is no maximum.
    """

    def shifted(step: float) -> Floats:
        turn = _turn(step * YAW_STEP_RAD)[:2, :2]
        return np.asarray(view.centre_m - turn @ (view.centre_m - shift_m))

    sums = []
    for step in (-1.0, 0.0, 1.0):
        turned = _turn(turn_rad + step * YAW_STEP_RAD) @ tilt
        aligned = view.plane.seen(frame, turned, shifted(step))
        sums.append(_agreement(view, *aligned)[0][:, 4])
    less, same, more = sums
    bend = float((less - 2 * same + more).sum())
    if bend >= 0:
        return None
    place = 0.5 * float((less - more).sum()) / bend
    if abs(place) > 1:
        return None
    slopes = 0.5 * (more - less) + place * (less - 2 * same + more)
    variance = float((slopes**2).sum()) / bend**2 * YAW_STEP_RAD**2
    return turn_rad + place * YAW_STEP_RAD, variance, shifted(place)


def _agreement(view: _KeyframeView, image: Floats, image_weight: Floats) -> tuple[Floats, float]:
    """Correlate the keyframe and an aligned image under one weight, by sub-image.

    Returns:
        (blocks, 9) sums of products at the nine shifts of -1, 0, 1 cells, row by row; and the
        height of the sum over the noise of the whole correlation.
    """
    plane, weight = view.plane, view.weight * image_weight
    one, two = plane.whitened(view.image, weight), plane.whitened(image, weight)
    spread = float(plane.picture(two.conj() * one).std())
    a, b = plane.picture(one), plane.picture(two)
    rows = np.linspace(0, a.shape[0], BLOCKS[0] + 1).astype(int)[:-1]
    columns = np.linspace(0, a.shape[1], BLOCKS[1] + 1).astype(int)[:-1]
    sums = np.empty((BLOCKS[0] * BLOCKS[1], 9))
    for k in range(9):
        product = a * np.roll(b, (k // 3 - 1, k % 3 - 1), axis=(0, 1))
        by_row = np.add.reduceat(product, rows, axis=0)
        sums[:, k] = np.add.reduceat(by_row, columns, axis=1).ravel()
    height = float(sums[:, 4].sum()) / spread if spread > 0 else 0.0
    return sums, height


def _fitted(blocks: Floats) -> tuple[Floats, Floats] | None:
    """Fit a parabola to the peak; return its place (2,) and covariance (2, 2) in cells.

    The covariance is the sandwich estimator of an M-estimate (Huber, The behavior of maximum
    likelihood estimates under nonstandard conditions, 1967): the sub-images' slopes at the
    peak add up to zero, and scatter by their noise and by how far they disagree.

    Args:
        blocks: as of `_agreement`.
    """
    total = blocks.sum(axis=0)
    bend = _hessian(total)
    if bend[0, 0] >= 0 or float(np.linalg.det(bend)) <= 0:
        return None
    inverse = np.linalg.inv(bend)
    place = -inverse @ _gradient(total)
    if float(np.abs(place).max()) > 1.5:  # noqa: PLR2004 the nine shifts do not enclose it
        return None
    slopes = np.array([_gradient(one) + _hessian(one) @ place for one in blocks])
    share = np.maximum(blocks[:, 4], 0.0)
    effective = float(share.sum()) ** 2 / max(float((share**2).sum()), 1e-300)
    if effective < MIN_BLOCKS:
        return None
    scatter = slopes.T @ slopes * (effective / (effective - 2.0))
    return place, inverse @ scatter @ inverse


def _gradient(nine: Floats) -> Floats:
    """Return the gradient (2,) at the middle of nine values, row by row."""
    return np.array([0.5 * (nine[7] - nine[1]), 0.5 * (nine[5] - nine[3])])


def _hessian(nine: Floats) -> Floats:
    """Return the second derivatives (2, 2) at the middle of nine values."""
    mixed = 0.25 * (nine[8] + nine[0] - nine[2] - nine[6])
    along, across = nine[7] + nine[1] - 2 * nine[4], nine[5] + nine[3] - 2 * nine[4]
    return np.array([[along, mixed], [mixed, across]])
