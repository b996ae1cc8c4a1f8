"""The study of localization: error of the pose against the filter's CPU time, with known truth.

Dives, odometry and scans are those of `studies.localization`; the map is the scene's true surface.
"""

from studies.accuracy_cost.localization.measuring import LocalizationStudy

__all__ = ["STUDY"]

STUDY = LocalizationStudy()
