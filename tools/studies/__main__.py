"""Run a study: `PYTHONPATH=tools python -m studies NAME [ARGUMENTS]`."""

import sys

from studies.runner import run_program

STUDIES = {
    "accuracy-cost": "studies.accuracy_cost.command",
    "adaptive-ratio": "studies.adaptive_ratio",
    "calibration": "studies.accuracy_cost.mapping.recalibration",
    "chaos": "studies.chaos.run",
    "drift": "studies.drift.run",
    "elevation": "studies.elevation.run",
    "hard-cases": "studies.numerics.catalogue",
    "localization-dives": "studies.localization.dives",
    "mutations": "mutations.run",
    "numerical-growth": "studies.numerics.run",
    "pose-error": "studies.pose_error",
    "scan-picture": "studies.scan_picture",
    "scan-truth": "studies.scan_truth",
    "scene-maps": "studies.scene_maps",
    "second-pass": "studies.localization.second_pass",
    "sim-check": "studies.sim_check",
    "simulator-pictures": "studies.simulator_pictures",
    "sonar-real": "studies.sonar_real",
    "stream": "studies.stream.run",
    "survey": "studies.survey.run",
    "survey-dives": "studies.survey.make_dives",
    "view-picture": "studies.view_picture",
}
"""Module of each study, which has a `main`."""

if __name__ == "__main__":
    sys.exit(run_program("studies", STUDIES, sys.argv[1:]))
