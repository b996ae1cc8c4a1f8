"""Settings of the engine for one ping: each effect sets its own fields.

A field's default leaves its effect out.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sonar_sim.raycast.fan import USUAL_ELEVATIONS_RAD


@dataclass(frozen=True, slots=True, eq=False)
class Mirror:
    """A plane that reflects sound specularly: the sea surface, a wall, a smooth floor.

    Attributes:
        point_m, normal: of the plane, map frame; the normal points into the water.
        reflection: of pressure, signed, coherence included.
        surface: whose faces in the plane are the mirror, by place in the scene or `meshes.SEA`;
            None is all of the plane.
        low_m, high_m: corners of a box that holds the mirror, map frame.
    """

    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    reflection: float
    surface: int | None = None
    low_m: NDArray[np.float64] = field(default_factory=lambda: np.full(3, -np.inf))
    high_m: NDArray[np.float64] = field(default_factory=lambda: np.full(3, np.inf))


@dataclass(frozen=True, slots=True, eq=False)
class SoundSpeedProfile:
    """Speed of sound over depth, for refraction: linear between the depths, constant beyond.

    Attributes:
        depth_m: increasing, (N,).
        speed_mps: (N,).
    """

    depth_m: NDArray[np.float64]
    speed_mps: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Bubbles or sediment in an axis-aligned box, map frame.

    Attributes:
        low_m, high_m: corners, (3,).
        attenuation_db_per_m: one way, beyond that of the water.
        volume_strength_db: back scattering strength, dB re 1/m.
    """

    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]
    attenuation_db_per_m: float
    volume_strength_db: float


@dataclass(frozen=True, slots=True)
class InterferencePulse:
    """The direct sound of another sonar in one ping.

    Attributes:
        time_s: of its start, after the transmission.
        duration_s: of its pulse.
        sine: of the bearing it comes from (cone angle of the array).
        level_db: dB re 1 µPa at the receiver, vertical pattern included.
    """

    time_s: float
    duration_s: float
    sine: float
    level_db: float


@dataclass(frozen=True, slots=True)
class Reverberation:
    """The tail that echoes leave behind them by scattering several times.

    Attributes:
        energy_per_m: mean power a metre of range, over the echoes' power summed over range.
        decay_db_per_m: by which it fades.
    """

    energy_per_m: float
    decay_db_per_m: float


@dataclass(slots=True, eq=False)
class Physics:
    """The effects' settings of one ping, in the order in which the sound meets them.

    Attributes:
        spreading: amplitude falls as 1/range each way.
        attenuation_db_per_m: one way, absorption and suspended sediment together.
        layers: sound speed profile for refraction; None is straight paths.
        range_scale: apparent range over true range (assumed over true speed of sound).
        pose_blocks: poses a ping, spread evenly over its listening time; 1 stands still.
        doppler_shift_s: apparent range grows by this times the closing speed, metres per m/s.
        lambert: back scattering falls as cos² of incidence; else each surface scatters alike.
        specular: smooth materials add their lobe.
        sea_surface: the sea's surface scatters; else it only ends the water.
        silent: names of surfaces that cast shadows but do not scatter.
        elevations_rad: lowest and highest elevation at which surfaces are looked for.
        mirrored_elevations_rad: the same of what is seen in mirrors.
        shadows: what is hit first hides the rest. Off: surfaces behind are heard too.
        mirrors: planes of multipath.
        clouds: volumes that absorb and scatter.
        vertical_width_rad: -3 dB full width, one way; None hears all elevations alike.
        beam_width_rad: azimuth -3 dB full width; None: each echo in its own beam only.
        side_lobe_db: of the azimuth pattern, positive; None: main lobe only.
        focus_m: nearer than this beams are wider, by the ratio; None: focused at every range.
        range_spread: neighbouring rows overlap.
        speckle: a coherent field of random scatterers; else mean powers.
        volume_strength_db: back scattering strength of the water itself, dB re 1/m.
        reverberation: tail behind echoes; None: sound comes back once.
        noise_level_db: per cell before gains, dB re 1 µPa.
        ring_down_db: of what rings after the transmission, dB of full scale at 50 % of gain.
        crosstalk_db: of a row's mean power into all its beams, negative.
        arrivals: other sonars.
        tvg: time-varied gain; gain: the operator's; both off is 0 dB.
        saturation: clip at full scale; else the pixel scale's end is only the quantiser's.
        gamma: the byte is obeyed; else linear.
        quantised: integers; else the image is float amplitude of full scale.
        sine_bearings: beams uniform in sine; else uniform in angle.
    """

    spreading: bool = False
    attenuation_db_per_m: float = 0.0
    layers: SoundSpeedProfile | None = None
    range_scale: float = 1.0
    pose_blocks: int = 1
    doppler_shift_s: float = 0.0
    lambert: bool = False
    specular: bool = False
    sea_surface: bool = False
    silent: frozenset[str] = frozenset()
    elevations_rad: tuple[float, float] = USUAL_ELEVATIONS_RAD
    mirrored_elevations_rad: tuple[float, float] = USUAL_ELEVATIONS_RAD
    shadows: bool = False
    mirrors: tuple[Mirror, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    vertical_width_rad: float | None = None
    beam_width_rad: float | None = None
    side_lobe_db: float | None = None
    focus_m: float | None = None
    range_spread: bool = False
    speckle: bool = False
    volume_strength_db: float | None = None
    reverberation: Reverberation | None = None
    noise_level_db: float | None = None
    ring_down_db: float | None = None
    crosstalk_db: float | None = None
    arrivals: tuple[InterferencePulse, ...] = field(default=())
    tvg: bool = False
    gain: bool = False
    saturation: bool = False
    gamma: bool = False
    quantised: bool = False
    sine_bearings: bool = False
