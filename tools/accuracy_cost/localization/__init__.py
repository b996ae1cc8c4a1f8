"""The study of localization: error of the pose against the filter's CPU time, with known truth.

Dives, odometry and scans are those of `tools/bench/localization_dives.py`, which says how true such
scans are; the map is the scene's true surface. `tools/bench` is on the path of whoever imports it.
"""

from accuracy_cost.localization.measuring import LocalizationStudy

__all__ = ["STUDY"]

STUDY = LocalizationStudy()
