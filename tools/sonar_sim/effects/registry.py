"""All effects, in the order in which the sound meets them."""

from types import MappingProxyType

from sonar_sim.effects.directivity import (
    ALL_ELEVATIONS,
    AZIMUTH_PATTERN,
    BEARING_TABLE,
    CROSSTALK,
    NEAR_FIELD,
    RANGE_SPREAD,
    SIDE_LOBES,
    VERTICAL_PATTERN,
)
from sonar_sim.effects.effect import Effect
from sonar_sim.effects.interference import INTERFERENCE
from sonar_sim.effects.multipath import MULTIPATH
from sonar_sim.effects.receiver_chain import (
    GAIN,
    GAMMA,
    NOISE,
    QUANTISATION,
    RING_DOWN,
    SATURATION,
    TVG,
)
from sonar_sim.effects.scattering import (
    BOTTOM_REVERBERATION,
    LAMBERT,
    REVERBERATION,
    SHADOWS,
    SPECKLE,
    SPECULAR,
    SURFACE_REVERBERATION,
    VOLUME,
)
from sonar_sim.effects.transmission_loss import ABSORPTION, BUBBLES, SPREADING, TURBIDITY
from sonar_sim.effects.travel_time import DOPPLER, MOTION, REFRACTION, SOUND_SPEED

_IN_ORDER = (
    SPREADING,
    ABSORPTION,
    SOUND_SPEED,
    REFRACTION,
    TURBIDITY,
    BUBBLES,
    AZIMUTH_PATTERN,
    SIDE_LOBES,
    VERTICAL_PATTERN,
    ALL_ELEVATIONS,
    BEARING_TABLE,
    NEAR_FIELD,
    RANGE_SPREAD,
    SHADOWS,
    LAMBERT,
    SPECULAR,
    SPECKLE,
    VOLUME,
    REVERBERATION,
    SURFACE_REVERBERATION,
    BOTTOM_REVERBERATION,
    MULTIPATH,
    MOTION,
    DOPPLER,
    NOISE,
    RING_DOWN,
    CROSSTALK,
    INTERFERENCE,
    TVG,
    GAIN,
    SATURATION,
    GAMMA,
    QUANTISATION,
)

EFFECTS = MappingProxyType({effect.name: effect for effect in _IN_ORDER})
"""By name."""


HEADINGS = ("effect", "what it does", "formula", "source", "computed if", "cost", "parameters")


def effects_markdown() -> str:
    """All effects, a row each, in Markdown."""
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS)]
    lines += [f"| {' | '.join(_cells(effect))} |" for effect in EFFECTS.values()]
    return "\n".join(lines) + "\n"


def _cells(effect: Effect) -> tuple[str, ...]:
    parameters = "; ".join(f"`{p.name}` ({p.unit}): {p.meaning}" for p in effect.parameters)
    cells = (
        f"`{effect.name}`",
        effect.does,
        effect.formula,
        effect.source,
        effect.rule,
        effect.cost.value,
        parameters or "none",
    )
    # A bar inside of a cell would end it.
    return tuple(cell.replace("|", "\\|") for cell in cells)
