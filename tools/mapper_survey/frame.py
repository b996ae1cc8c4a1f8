"""One dive's poses and motions, as the survey's frame has them."""

import numpy as np
from numpy.typing import NDArray

from mapper_survey.request import Transform
from mapperd.geometry.motion import PingMotion

__all__ = ["Frame"]

Floats = NDArray[np.float64]


class Frame:
    """The way from a dive's map frame into the survey's; without one nothing is computed.

    Args:
        transform: of the dive; None leaves poses as they are, to the bit.
    """

    def __init__(self, transform: Transform | None) -> None:
        self._survey_T_dive = None if transform is None else transform.matrix()

    def pose(self, dive_T_sonar: Floats) -> Floats:  # noqa: N803 frames are named
        """(4, 4) `survey_T_sonar`."""
        if self._survey_T_dive is None:
            return dive_T_sonar
        return self._survey_T_dive @ dive_T_sonar

    def motion(self, motion: PingMotion | None) -> PingMotion | None:
        """The same motion; its velocity is told in the map's frame, its turning in the sonar's."""
        if self._survey_T_dive is None or motion is None:
            return motion
        return PingMotion(
            linear_mps=self._survey_T_dive[:3, :3] @ motion.linear_mps,
            angular_radps=motion.angular_radps,
            valid_s=motion.valid_s,
            speed_of_sound_mps=motion.speed_of_sound_mps,
        )
