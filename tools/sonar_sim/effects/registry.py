"""All effects, in the order in which the sound meets them."""

from types import MappingProxyType

from sonar_sim.effects.absorption import EFFECT as ABSORPTION
from sonar_sim.effects.azimuth_pattern import EFFECT as AZIMUTH_PATTERN
from sonar_sim.effects.bearing_table import EFFECT as BEARING_TABLE
from sonar_sim.effects.bottom_reverberation import EFFECT as BOTTOM_REVERBERATION
from sonar_sim.effects.bubbles import EFFECT as BUBBLES
from sonar_sim.effects.crosstalk import EFFECT as CROSSTALK
from sonar_sim.effects.doppler import EFFECT as DOPPLER
from sonar_sim.effects.gain import EFFECT as GAIN
from sonar_sim.effects.gamma import EFFECT as GAMMA
from sonar_sim.effects.interference import EFFECT as INTERFERENCE
from sonar_sim.effects.lambert import EFFECT as LAMBERT
from sonar_sim.effects.motion import EFFECT as MOTION
from sonar_sim.effects.multipath import EFFECT as MULTIPATH
from sonar_sim.effects.noise import EFFECT as NOISE
from sonar_sim.effects.quantisation import EFFECT as QUANTISATION
from sonar_sim.effects.range_spread import EFFECT as RANGE_SPREAD
from sonar_sim.effects.refraction import EFFECT as REFRACTION
from sonar_sim.effects.saturation import EFFECT as SATURATION
from sonar_sim.effects.shadows import EFFECT as SHADOWS
from sonar_sim.effects.side_lobes import EFFECT as SIDE_LOBES
from sonar_sim.effects.sound_speed import EFFECT as SOUND_SPEED
from sonar_sim.effects.speckle import EFFECT as SPECKLE
from sonar_sim.effects.specular import EFFECT as SPECULAR
from sonar_sim.effects.spreading import EFFECT as SPREADING
from sonar_sim.effects.surface_reverberation import EFFECT as SURFACE_REVERBERATION
from sonar_sim.effects.turbidity import EFFECT as TURBIDITY
from sonar_sim.effects.tvg import EFFECT as TVG
from sonar_sim.effects.vertical_pattern import EFFECT as VERTICAL_PATTERN
from sonar_sim.effects.volume import EFFECT as VOLUME

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
    BEARING_TABLE,
    RANGE_SPREAD,
    SHADOWS,
    LAMBERT,
    SPECULAR,
    SPECKLE,
    VOLUME,
    SURFACE_REVERBERATION,
    BOTTOM_REVERBERATION,
    MULTIPATH,
    MOTION,
    DOPPLER,
    NOISE,
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
