import json
import math
import re
from typing import Any

import jsonschema
import msgspec
import numpy as np
import pytest
from config_docs.schema import json_schema

from mapperd.config.aliases import ALIASES, IGNORED, change_renamed, restored_changes
from mapperd.config.amcl import CORRECTED
from mapperd.config.catalog import parameters
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore, Refused, with_values
from mapperd.config.loader import config_from_text, config_of
from mapperd.config.tree import AmclConfig, Config
from mapperd.errors import ConfigError

PUBLISHED = {
    "base_frame_id": "base_footprint",
    "odom_frame_id": "odom",
    "global_frame_id": "map",
    "map_topic": "map",
    "use_map_topic": True,
    "initial_pose_topic": "initialpose",
    "set_initial_pose": False,
    "initial_pose_x": 0.0,
    "initial_pose_y": 0.0,
    "initial_pose_a": 0.0,
    "initial_cov_xx": 0.0,
    "initial_cov_yy": 0.0,
    "initial_cov_aa": 0.0,
    "initial_cov_xy": 0.0,
    "initial_cov_xa": 0.0,
    "initial_cov_ya": 0.0,
    "always_reset_initial_pose": False,
    "save_pose_rate": 0.5,
    "first_map_only": False,
    "tf_broadcast": True,
    "transform_tolerance": 1.0,
    "max_particles": 5000,
    "min_particles": 100,
    "pf_z": 0.99,
    "pf_err": 0.05,
    "spatial_resolution_x": 0.5,
    "spatial_resolution_y": 0.5,
    "spatial_resolution_theta": math.radians(10),
    "recovery_alpha_fast": 0.001,
    "recovery_alpha_slow": 0.1,
    "resample_interval": 2,
    "selective_resampling": False,
    "update_min_a": 0.2,
    "update_min_d": 0.523598,
    "execution_policy": "seq",
    "robot_model_type": "differential_drive",
    "odom_alpha1": 0.2,
    "odom_alpha2": 0.2,
    "odom_alpha3": 0.2,
    "odom_alpha4": 0.2,
    "odom_alpha5": 0.2,
    "laser_model_type": "likelihood_field",
    "laser_max_range": 100.0,
    "laser_min_range": 0.0,
    "max_beams": 60,
    "laser_sigma_hit": 0.2,
    "laser_z_hit": 0.5,
    "laser_z_rand": 0.5,
    "laser_z_short": 0.05,
    "laser_lambda_short": 0.1,
    "laser_likelihood_max_dist": 2.0,
    "std_warn_level_x": 0.2,
    "std_warn_level_y": 0.2,
    "std_warn_level_yaw": 0.2,
    "restore_defaults": False,
}
"""What the published document prints."""

SWAPPED = {
    "recovery_alpha_fast": 0.1,
    "recovery_alpha_slow": 0.001,
    "update_min_a": pytest.approx(0.523598, abs=1e-6),
    "update_min_d": 0.2,
}

ONLY_AT_START = {
    "base_frame_id",
    "odom_frame_id",
    "global_frame_id",
    "map_topic",
    "use_map_topic",
    "initial_pose_topic",
    "selective_resampling",
}


def amcl_of(text: str) -> AmclConfig:
    return config_from_text("amcl: {" + text + "}").amcl


def following() -> ConfigStore:
    store = ConfigStore(Layered())
    store.follow(["amcl"], lambda _: None)
    return store


def test_all_58_published_parameters_but_three_are_there_with_their_defaults_but_the_swapped() -> (
    None
):
    ignored = {name for name in IGNORED if name.startswith("amcl.")} - {"amcl.z_max"}
    assert ignored == {"amcl.scan_topic", "amcl.map_service", "amcl.laser_z_max"}
    assert len(PUBLISHED) + len(ignored) == 58
    assert msgspec.to_builtins(AmclConfig()) == PUBLISHED | SWAPPED


def test_what_is_otherwise_than_published_is_listed() -> None:
    assert set(CORRECTED) == {*SWAPPED, "save_pose_rate"}


def test_all_may_change_while_running_but_names_and_sources() -> None:
    fixed = {name for name in PUBLISHED if not parameters()[f"amcl.{name}"].dynamic}
    assert fixed == ONLY_AT_START


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("max_particles: 50", r"min_particles 100 is above max_particles 50"),
        ("recovery_alpha_fast: 0.0001", "recovery_alpha_slow 0.001 is above"),
        ("laser_min_range: 100", "laser_min_range 100 is not below laser_max_range"),
        ("laser_max_range: -1", r"\$\.amcl\.laser_max_range: -1 is not allowed"),
        ("resample_interval: 0", "resample_interval: 0 is not allowed"),
        ("pf_err: 0", "pf_err: 0 is not allowed"),
        ("spatial_resolution_x: 0", "spatial_resolution_x: 0 is not allowed"),
        ("pf_z: .nan", "pf_z"),
        ("laser_z_hit: 0, laser_z_rand: 0", "both 0"),
        ("robot_model_type: diff", "allowed: differential_drive or omnidirectional_drive"),
        ("initial_cov_xy: 0.1", "not a covariance"),
        ("initial_cov_xx: 1, initial_cov_yy: 1, initial_cov_xy: 1.1", "not a covariance"),
        (
            (
                "initial_cov_xx: 1, initial_cov_yy: 1, initial_cov_aa: 1, initial_cov_xy: 0.9, "
                "initial_cov_xa: 0.9, initial_cov_ya: -0.9"
            ),
            "not a covariance",
        ),
    ],
)
def test_what_no_filter_could_work_with_is_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        amcl_of(text)


@pytest.mark.parametrize(
    "text",
    [
        (
            "initial_cov_xx: 1, initial_cov_yy: 1, initial_cov_aa: 1, initial_cov_xy: 1, "
            "initial_cov_xa: 1, initial_cov_ya: 1"
        ),
        "initial_cov_xx: 0.3, initial_cov_yy: 0.027, initial_cov_xy: 0.09",
        "initial_cov_aa: 0.1",
    ],
)
def test_singular_covariances_are_covariances(text: str) -> None:
    amcl = msgspec.to_builtins(amcl_of(text))
    names = [["".join(sorted(a + b, key="xya".index)) for b in "xya"] for a in "xya"]
    rows = [[amcl[f"initial_cov_{name}"] for name in row] for row in names]
    least, *_, largest = np.linalg.eigvalsh(rows)
    assert least == pytest.approx(0.0, abs=1e-9 * largest)
    assert largest > 0


def test_names_of_other_releases_are_taken() -> None:
    amcl = amcl_of(
        "kld_err: 0.01, kld_z: 3, odom_model_type: omni-corrected, alpha1: 0.1, alpha5: 0.5, "
        "laser_max_beams: 100, sigma_hit: 0.3, z_hit: 0.9, z_rand: 0.1, z_max: 0.2, z_short: 0.3, "
        "lambda_short: 0.7, initial_pose: {x: 1, y: 2, yaw: 3, covariance_x: 0.04, "
        "covariance_y: 0.09, covariance_yaw: 0.01, covariance_xy: 0.01, covariance_xyaw: 0.002, "
        "covariance_yyaw: 0.003}"
    )
    stated = {k: v for k, v in msgspec.to_builtins(amcl).items() if v != getattr(AmclConfig(), k)}
    assert stated == {
        "pf_err": 0.01,
        "pf_z": 3,
        "robot_model_type": "omnidirectional_drive",
        "odom_alpha1": 0.1,
        "odom_alpha5": 0.5,
        "max_beams": 100,
        "laser_sigma_hit": 0.3,
        "laser_z_hit": 0.9,
        "laser_z_rand": 0.1,
        "laser_z_short": 0.3,
        "laser_lambda_short": 0.7,
        "initial_pose_x": 1,
        "initial_pose_y": 2,
        "initial_pose_a": 3,
        "initial_cov_xx": 0.04,
        "initial_cov_yy": 0.09,
        "initial_cov_aa": 0.01,
        "initial_cov_xy": 0.01,
        "initial_cov_xa": 0.002,
        "initial_cov_ya": 0.003,
    }


@pytest.mark.parametrize(
    ("other", "ours"),
    [
        ("diff-corrected", "differential_drive"),
        ("nav2_amcl::DifferentialMotionModel", "differential_drive"),
        ("nav2_amcl::OmniMotionModel", "omnidirectional_drive"),
        ("stationary", "stationary"),
    ],
)
def test_motion_models_of_other_releases_are_taken(other: str, ours: str) -> None:
    assert amcl_of(f"robot_model_type: {other!r}").robot_model_type == ours


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kld_err: 0.01, pf_err: 0.02", r"amcl\.pf_err.* also set"),
        ("kld_err: 2", r"\$\.amcl\.pf_err: 2 is not allowed"),
        ("initial_pose: {x: 1, z: 2}", r"\$\.amcl\.initial_pose: there is no such setting"),
        ("initial_pose: 3", r"\$\.amcl\.initial_pose: there is no such setting"),
        ("kld_er: 2", r"\$\.amcl\.kld_er: there is no such setting"),
        ("1: 2", "a key is not a name"),
    ],
)
def test_other_names_are_no_way_around_the_checks(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        amcl_of(text)


def test_every_other_name_stands_for_a_setting() -> None:
    assert set(ALIASES.values()) <= set(parameters())
    assert not set(ALIASES) & set(parameters())


def test_former_names_of_localization_are_read() -> None:
    config = config_of({"localization": {"rival_interval": 3.0}}, "an old recording")
    assert config.localization.alternative_interval == 3.0
    changed = with_values(config, {"localization.rival_interval": 4.0})
    assert changed.localization.alternative_interval == 4.0
    both = {"localization": {"rival_interval": 3.0, "alternative_interval": 5.0}}
    assert config_of(both, "a file").localization.alternative_interval == 5.0


def test_schema_lets_other_names_through() -> None:
    judge = jsonschema.Draft202012Validator(json_schema())
    assert judge.is_valid({"localization": {"rival_interval": 3.0}})
    tree: dict[str, Any] = {"amcl": {"kld_z": 2.3, "initial_pose": {"yaw": 1}}}
    assert judge.is_valid(tree)
    assert judge.is_valid({"amcl": {"odom_model_type": "diff-corrected"}})
    assert judge.is_valid({"amcl": {"robot_model_type": "diff-corrected"}})
    assert not judge.is_valid({"amcl": {"initial_pose": {"z": 1}}})
    assert not judge.is_valid({"amcl": {"kld_z": 11}})


def test_setting_without_effect_is_refused_with_its_reason() -> None:
    refused = following().apply({"amcl.laser_z_max": 0.1}, "x")
    assert isinstance(refused, Refused)
    assert "no effect: beams without a return" in refused.reasons["amcl.laser_z_max"]


def test_store_takes_other_names_and_refuses_two_for_one() -> None:
    store = following()
    assert isinstance(store.apply({"amcl.kld_z": 2.3}, "x"), Applied)
    assert store.current.amcl.pf_z == 2.3
    assert store.origin_of("amcl.pf_z") == "x"
    refused = store.apply({"amcl.kld_z": 2.4, "amcl.pf_z": 2.4}, "x")
    assert isinstance(refused, Refused)
    assert "also set" in next(iter(refused.reasons.values()))
    assert store.current.amcl.pf_z == 2.3


def test_change_of_nothing_known_stays_as_it_is() -> None:
    changes = {"octree.voxel_resolution": 0.1, "amcl": 3}
    assert change_renamed(changes) == changes


def test_defaults_of_the_start_are_restored_and_the_request_taken_back() -> None:
    store = ConfigStore(Layered(config_from_text("amcl: {max_beams: 90}")))
    store.follow(["amcl"], lambda _: None)
    store.apply({"amcl.max_beams": 30, "amcl.pf_z": 3.0, "amcl.tf_broadcast": False}, "x")
    result = store.apply({"amcl.restore_defaults": True}, "x")
    assert isinstance(result, Applied)
    assert {change.name for change in result.changes} == {
        "amcl.max_beams",
        "amcl.pf_z",
        "amcl.tf_broadcast",
    }
    assert store.current.amcl == AmclConfig(max_beams=90)
    assert store.current.amcl.restore_defaults is False


def test_restoring_and_changing_at_once_is_refused() -> None:
    store = following()
    result = store.apply({"amcl.restore_defaults": True, "amcl.pf_z": 3.0}, "x")
    assert isinstance(result, Refused)
    assert "undoes amcl.pf_z" in result.reasons["amcl.restore_defaults"]
    assert store.current == Config()


def test_other_sections_may_change_with_it() -> None:
    changes = restored_changes({"amcl.restore_defaults": True, "mapping.threads": 2}, AmclConfig())
    assert changes["mapping.threads"] == 2
    assert changes["amcl.restore_defaults"] is False
    assert not [name for name in changes if name.removeprefix("amcl.") in ONLY_AT_START]


def test_asking_for_defaults_at_the_start_is_having_them() -> None:
    assert amcl_of("restore_defaults: true") == AmclConfig()


def test_all_settings_have_a_unit_or_need_none() -> None:
    numbers = [one for name, one in parameters().items() if re.match(r"amcl\.(init|upd|std)", name)]
    assert all(one.unit for one in numbers if isinstance(one.default, float))
    assert json.dumps([one.default for one in numbers])
