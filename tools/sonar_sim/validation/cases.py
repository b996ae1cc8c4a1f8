"""The list of cases, in the order of their numbers; a new case is given its place here."""

from collections.abc import Callable
from types import MappingProxyType

from sonar_sim.validation.case import CaseResult
from sonar_sim.validation.v01_absorption import v01_absorption
from sonar_sim.validation.v02_range_slopes import v02_range_slopes
from sonar_sim.validation.v03_lambert_floor import v03_lambert_floor
from sonar_sim.validation.v04_spheres import v04_spheres
from sonar_sim.validation.v05_plate import v05_plate
from sonar_sim.validation.v06_beam_pattern import v06_beam_pattern
from sonar_sim.validation.v07_speckle import v07_speckle
from sonar_sim.validation.v08_ping_correlation import v08_ping_correlation
from sonar_sim.validation.v09_range_lines import v09_range_lines
from sonar_sim.validation.v10_mirror_ghosts import v10_mirror_ghosts
from sonar_sim.validation.v11_shadow import v11_shadow
from sonar_sim.validation.v12_elevation import v12_elevation
from sonar_sim.validation.v13_bearings import v13_bearings
from sonar_sim.validation.v14_quantiser import v14_quantiser
from sonar_sim.validation.v15_timing import v15_timing
from sonar_sim.validation.v16_motion import v16_motion
from sonar_sim.validation.v17_no_wrap import v17_no_wrap
from sonar_sim.validation.v18_classic import v18_classic
from sonar_sim.validation.v19_determinism import v19_determinism
from sonar_sim.validation.v20_tank import v20_tank

CASES: MappingProxyType[str, Callable[[], CaseResult]] = MappingProxyType(
    {
        "V1": v01_absorption,
        "V2": v02_range_slopes,
        "V3": v03_lambert_floor,
        "V4": v04_spheres,
        "V5": v05_plate,
        "V6": v06_beam_pattern,
        "V7": v07_speckle,
        "V8": v08_ping_correlation,
        "V9": v09_range_lines,
        "V10": v10_mirror_ghosts,
        "V11": v11_shadow,
        "V12": v12_elevation,
        "V13": v13_bearings,
        "V14": v14_quantiser,
        "V15": v15_timing,
        "V16": v16_motion,
        "V17": v17_no_wrap,
        "V18": v18_classic,
        "V19": v19_determinism,
        "V20": v20_tank,
    }
)
