"""V14: the pixel is the amplitude's power gamma, in each width."""

from typing import TYPE_CHECKING

import numpy as np

from sonar_sim import _core
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.gain import quantise
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AMPLITUDES = np.array([1.0, 0.25, 0.0625, 1.0 / 65025.0], dtype=np.float32)
AT_ONE_HALF = (255.0, 127.5, 63.75, 1.0)
BOTH = Physics(gamma=True, saturation=True, quantised=True)


def v14_quantiser() -> CaseResult:
    """Values of the reference, and the ends of 8, 16 and 32 bits."""
    curve = 255.0 * _core.pixels(AMPLITUDES, 0.5, 0, clip=True)
    eight = _core.pixels(AMPLITUDES, 0.5, 8, clip=True)
    checks = [
        Check(f"255 A^0.5 at A = {a:.3g}", want, float(got), 1e-3)
        for a, want, got in zip(AMPLITUDES, AT_ONE_HALF, curve, strict=True)
    ]
    checks += [
        Check(f"8 bit at A = {a:.3g}", want, float(got), 0.5)
        for a, want, got in zip(AMPLITUDES, AT_ONE_HALF, eight, strict=True)
    ]
    sixteen = quantise(AMPLITUDES, BOTH, gamma_byte=255, bits=16)
    checks += [
        Check(f"16 bit, linear, at A = {a:.3g}", 65535.0 * float(a), float(got), 0.5)
        for a, got in zip(AMPLITUDES, sixteen, strict=True)
    ]
    over = np.array([1.0, 1.7, 1e9], dtype=np.float32)
    for bits in (8, 16, 32):
        end = float(quantise(over, BOTH, gamma_byte=127, bits=bits).min())
        checks.append(Check(f"{bits} bit: end of the scale", 2.0**bits - 1.0, end, 0.0))
    return CaseResult("V14 quantiser", "pixel = full scale A^gamma", tuple(checks), _draw)


def _draw(axes: "Axes") -> None:
    amplitude = np.geomspace(1e-5, 2.0, 400).astype(np.float32)
    for gamma_byte in (255, 127, 64):
        image = quantise(amplitude, BOTH, gamma_byte=gamma_byte)
        axes.semilogx(amplitude, image, lw=1.0, label=f"gamma byte {gamma_byte}")
    axes.semilogx(AMPLITUDES, AT_ONE_HALF, "k+", ms=8)
    axes.set_xlabel("amplitude of full scale")
    axes.set_ylabel("8-bit pixel")
    axes.legend(fontsize=6)
