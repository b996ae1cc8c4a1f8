from pathlib import Path

import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene_file import load_scenario

PATH = "trajectory: {waypoints: [{position_m: [0, 0, -2]}, {position_m: [%s, 0, -2]}]%s}\n"


@pytest.mark.parametrize(
    "setting",
    [
        "water: {profile: [[0, .nan], [5, 1500]]}",
        "vehicle: {odometry: {drift_mps: [.inf, 0, 0]}}",
        "vehicle: {odometry: {attitude_bias_deg: [0, 1e999, 0]}}",
    ],
)
def test_a_number_that_is_not_finite_is_refused_with_its_line(setting: str, tmp_path: Path) -> None:
    file = tmp_path / "odd.yaml"
    file.write_text(PATH % (2, "") + setting, encoding="utf-8")
    with pytest.raises(SceneError, match=r"odd\.yaml: line 2: "):
        load_scenario(str(file))


@pytest.mark.parametrize(("length_m", "more"), [("1e-9", ""), ("1e+5", ", speed_mps: 1e-3")])
def test_a_path_of_no_time_or_of_months_is_refused(
    length_m: str, more: str, tmp_path: Path
) -> None:
    file = tmp_path / "odd.yaml"
    file.write_text(PATH % (length_m, more), encoding="utf-8")
    with pytest.raises(SceneError, match=r"odd\.yaml: \$\.trajectory: .*0\.01 to"):
        load_scenario(str(file))
