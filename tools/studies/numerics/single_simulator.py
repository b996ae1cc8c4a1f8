"""Single precision in the simulator: rays, echoes, beams, pixels."""

import numpy as np
from numpy.typing import NDArray
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.physics import Physics
from sonar_sim.raycast.meshes import Meshes
from sonar_sim.receiver.beamformer import beam_former
from sonar_sim.receiver.gain import amplitude, quantise
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

from studies.numerics.single_places import SingleError, SinglePlace

__all__ = ["PLACES"]


def _rays() -> SingleError:
    """A slanting plane 1000 km from the map's origin, against its equation."""
    far = np.array([1e6, -2e6, -50.0])
    corners = np.array([[0.0, -200.0, -100.0], [0.0, 200.0, -100.0], [150.0, 0.0, 120.0]])
    plane = Surface("plane", corners + far + [40.0, 0, 0], np.array([[0, 1, 2]]), MATERIALS["sand"])
    chance = np.random.default_rng(11)
    direction = np.column_stack([np.ones(20_000), chance.uniform(-0.4, 0.4, (20_000, 2))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    rounded = direction.astype(np.float32)
    met = Meshes(Scene((plane,))).cast(far, rounded, 0.0, 500.0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    exact = normal @ (corners[0] + [40.0, 0, 0]) / (rounded.astype(np.float64) @ normal)
    hit = np.isfinite(met.range_m)
    off = np.abs(met.range_m[hit] - exact[hit]).max()
    return SingleError(
        f"{off:.1e} m of {exact[hit].max():.0f} m", "a hundredth of the thinnest row"
    )


def _scattering() -> SingleError:
    """A scene and its mirror image: other numbers all along, and the same image mirrored."""
    image = _amplitude(1.0)
    mirrored = _amplitude(-1.0)[:, ::-1]
    lit = image > image.max() / 1000.0
    off = 20.0 * np.abs(np.log10(mirrored[lit] / image[lit]))
    return SingleError(f"{off.max():.0e} dB, down to -60 dB", "a pixel's step is 0.03 dB and more")


def _amplitude(side: float) -> NDArray[np.float64]:
    """Amplitudes of a floor and a wall of mean power, port and starboard exchanged or not."""
    sonar = SonarSettings(beams=256)
    corners = np.array(
        [[2, -12, -3], [2, 12, -3], [14, 12, -2.6], [14, -12, -3.1], [8, -12, -3], [8, 12, 4]]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 1, 5]])
    scene = Scene((Surface("s", corners * [1, side, 1], faces, MATERIALS["sand"]),))
    physics = Physics(
        spreading=True,
        lambert=True,
        shadows=True,
        beam_width_rad=sonar.beam_width_rad,
        vertical_width_rad=sonar.vertical_width_rad,
        tvg=True,
        gain=True,
        sine_bearings=True,
    )
    ping = PingEngine(scene, sonar).ping(FramePose(np.zeros(3), np.eye(3)), physics)
    return ping.amplitude.astype(np.float64)


def _phases() -> SingleError:
    """Ranges of points up to 120 m off, and the phase of the way there and back at 750 kHz."""
    points = np.random.default_rng(15).uniform(-70.0, 70.0, (100_000, 3))
    single = np.sqrt(np.sum(np.square(points.astype(np.float32)), axis=1))
    exact = np.linalg.norm(points, axis=1)
    turns = np.abs(single - exact).max() * 2.0 * 750e3 / 1500.0
    return SingleError(
        f"{turns:.0e} of a turn at {exact.max():.0f} m",
        "speckle seen from two places beside each other is alike to 0.998",
    )


def _echoes() -> SingleError:
    """Ten thousand echoes of random phase in each of 200 cells."""
    phase = np.random.default_rng(12).uniform(0.0, 2 * np.pi, (10_000, 200))
    field = np.exp(1j * phase).astype(np.complex64)
    single = np.cumsum(field, axis=0, dtype=np.complex64)[-1].astype(np.complex128)
    exact = field.sum(axis=0, dtype=np.complex128)
    decibels = 20 * np.abs(np.log10(np.abs(single) / np.abs(exact)))
    return SingleError(f"{decibels.max():.0e} dB", "a pixel's step is 0.03 dB and more")


def _beams() -> SingleError:
    """The beam former's transform, against a plain convolution in double precision."""
    sonar = SonarSettings(beams=256)
    physics = Physics(beam_width_rad=sonar.beam_width_rad, side_lobe_db=30.0, sine_bearings=True)
    former = beam_former(sonar, physics, 8)
    chance = np.random.default_rng(13)
    columns = 256 + 2 * 8
    parts = chance.normal(size=(2, 16, columns)).astype(np.float32)
    cells = (parts[0] + 1j * parts[1]).astype(np.complex64)
    got = former.form(cells)
    if not isinstance(former.firsts, int):
        raise TypeError("beams of even sines have one first column")
    reach = (former.taps.size - 1) // 2
    padded = np.pad(cells.astype(np.complex128), ((0, 0), (reach, reach)))
    taps = former.taps.astype(np.float64)[::-1]
    first = former.firsts
    exact = np.array([np.convolve(row, taps, "valid") for row in padded])[:, first : first + 256]
    off = np.abs(got - exact).max() / np.sqrt(np.mean(np.abs(exact) ** 2))
    return SingleError(f"{-20 * np.log10(off):.0f} dB under the echoes", "side lobes are at -30 dB")


def _pixels() -> SingleError:
    """Amplitudes to pixels of 8 and 16 bit at a gamma, against powers in double precision."""
    beams = np.random.default_rng(14).rayleigh(0.3, (1000, 256)).astype(np.float32)
    shown = amplitude(np.square(beams), np.ones(1000, np.float32))
    physics = Physics(saturation=True, gamma=True, quantised=True)
    lines = []
    for bits in (8, 16):
        end = 2**bits - 1
        got = quantise(shown, physics, 127, bits).astype(np.int64)
        exact = np.rint(end * np.minimum(shown.astype(np.float64), 1.0) ** (127 / 255))
        off = np.abs(got - exact)
        lines.append(f"{100 * np.mean(off > 0):.2g} % of {bits}-bit pixels by {off.max():.0f}")
    return SingleError("; ".join(lines), "speckle moves every pixel by 5 dB")


PLACES = (
    SinglePlace(
        "`meshes`, `tracing`",
        "corners, directions and ranges",
        _rays,
        "corners count from their scene's middle, the sonar's pose stays in double precision",
    ),
    SinglePlace(
        "`footprint`, `scatter_*`",
        "what a patch sends back, and where it is heard",
        _scattering,
        "patches are placed in rows and columns about the sonar, in metres from it",
    ),
    SinglePlace(
        "`nodes`",
        "places of a patch's scatterers, and their phases",
        _phases,
        "they count from the transmitter; twice the numbers a vector and a cache",
        "a scatterer is placed where it is heard, and has no twin in double precision",
    ),
    SinglePlace(
        "`deposit`, `random`, `echo_response`",
        "echoes and the cells that they fall into",
        _echoes,
        "twice the numbers a vector and a cache; bits do not depend on the number of threads",
        "a cell's echoes are added where they are made, and have no twin in double precision",
    ),
    SinglePlace(
        "`convolution`, `beams`",
        "beams, by Fourier transform",
        _beams,
        "eight rows at a time",
    ),
    SinglePlace(
        "`receiver`, `fast_math`",
        "gain, gamma and the quantiser",
        _pixels,
        "series without branches, the same bits on every machine",
    ),
)
