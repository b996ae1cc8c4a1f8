"""What is turned in the study of localization."""

from collections.abc import Mapping
from typing import Any

import msgspec
import yaml

from mapperd.config.loader import config_of
from mapperd.config.tree import Config, OctreeConfig
from studies.accuracy_cost.study import Knob, Setting, Value
from studies.localization.runs import settings
from studies.localization.world import DiveArea
from studies.report import ROOT

__all__ = ["KNOBS", "SCALES", "WHOLES", "config_for", "profile_overrides", "published_overrides"]


CONFIG = ROOT / "config"
PROFILE = CONFIG / "localization.yaml"
"""Of the harbour; `dive_runs.settings` has it for every place, and a test holds both equal."""

SCALES = {
    "scale.cells": ("octree.voxel_resolution",),
    "scale.step": ("amcl.update_min_d", "localization.update_max_interval"),
    "scale.sigma": ("amcl.laser_sigma_hit",),
    "scale.rivals": ("localization.alternative_interval",),
}
"""Factors that a study turns, and the settings that they multiply: these differ between places."""


def config_for(place: DiveArea, overrides: Mapping[str, Value], seed: int) -> Config:
    """The profile for a place with some settings turned.

    Args:
        place: where is dived.
        overrides: settings by dotted name, and factors of `SCALES`.
        seed: of the particles.

    Raises:
        ConfigError: no such setting, or a value that it does not take.
    """
    base = msgspec.structs.replace(
        settings(place, seed), octree=OctreeConfig(voxel_resolution=place.voxel_m)
    )
    tree: dict[str, Any] = msgspec.to_builtins(base)
    for name, value in overrides.items():
        if name in SCALES:
            for scaled in SCALES[name]:
                section, field = scaled.split(".")
                tree[section][field] *= value
        else:
            section, field = name.split(".")
            tree.setdefault(section, {})[field] = value
    return config_of(tree, "study")


def published_overrides() -> dict[str, Value]:
    """What the profile sets, back at the defaults, which are the published ones; and a planar map.

    Settings that Beluga AMCL does not have are off by their defaults.
    """
    profile = yaml.safe_load(PROFILE.read_text(encoding="utf-8"))
    defaults = msgspec.to_builtins(Config())
    overrides: dict[str, Value] = {
        f"{section}.{name}": defaults[section][name]
        for section in ("amcl", "localization")
        for name in profile[section]
    }
    return overrides | {"localization.geometry": "2d"}


def profile_overrides(name: str) -> dict[str, Value]:
    """Read the localization settings of a profile in `config/`; empty without such a file."""
    path = CONFIG / f"{name}.yaml"
    if not path.exists():
        return {}
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        f"{section}.{key}": value
        for section in ("amcl", "localization")
        for key, value in (tree.get(section) or {}).items()
    }


PROFILES = ("low_power", "balanced", "survey")
MARGIN = 0.15
"""Errors of two runs with other random numbers differ by about so much."""


def _turned(name: str, default: str, *values: Value) -> tuple[Setting, ...]:
    """Positions of one setting; that of `default` has no overrides."""
    labels = [str(value) for value in values]
    return tuple(
        Setting(label, {} if label == default else {name: value})
        for label, value in zip(labels, values, strict=True)
    )


def _always(count: int) -> Setting:
    return Setting(str(count), {"amcl.max_particles": count, "amcl.min_particles": count})


def _resampled(label: str, interval: int, *, selective: bool) -> Setting:
    return Setting(
        label, {"amcl.resample_interval": interval, "amcl.selective_resampling": selective}
    )


def _scaled(name: str, *factors: float) -> tuple[Setting, ...]:
    """Factors of settings that differ between places."""
    return tuple(Setting(f"x {f:g}", {} if f == 1 else {name: f}) for f in factors)


KNOBS = (
    Knob(
        "particles",
        "Particles; one number: always as many",
        (
            _always(100),
            _always(300),
            _always(1000),
            _always(3000),
            _always(10000),
            _always(20000),
            Setting("100 to 5000", {"amcl.min_particles": 100, "amcl.max_particles": 5000}),
            Setting("500 to 5000", {"amcl.max_particles": 5000}),
            Setting("500 to 10000", {}),
            Setting("500 to 30000", {"amcl.max_particles": 30000}),
        ),
        "100 to 5000",
        MARGIN,
        "A followed vehicle needs some hundred; a constant 300 are less exact in small places. "
        "With at most 5000, sparse alternatives take over at times (docs/guides/localization.md).",
    ),
    Knob(
        "fewest-particles",
        "Particles of a cloud that has found its place",
        _turned("amcl.min_particles", "500", 50, 100, 200, 500, 1000, 2000),
        "100",
        MARGIN,
        "Hardly matters: finding a place costs, keeping it does not.",
    ),
    Knob(
        "beams",
        "Beams of a scan that are weighed",
        _turned("amcl.max_beams", "60", 5, 10, 20, 30, 60, 120),
        "60",
        MARGIN,
        "Leave it. Below 30 a lost vehicle is found less often, and the search costs more than "
        "the beams save.",
        quick=True,
    ),
    Knob(
        "cells",
        "Edge of the map's cells, in times of 0.1 m (tank 0.05 m)",
        _scaled("scale.cells", 1.0, 1.5, 2.0, 3.0, 5.0),
        None,
        MARGIN,
        "Cells twice as large save a third of the time, and memory by their cube.",
    ),
    Knob(
        "model",
        "How scans are weighed",
        _turned(
            "amcl.laser_model_type",
            "likelihood_field_prob",
            "likelihood_field",
            "likelihood_field_prob",
            "beam",
        ),
        "likelihood_field",
        MARGIN,
        "The sum of cubes can neither be tempered nor show that it is lost; rays on a planar map "
        "hardly find a lost vehicle.",
        quick=True,
    ),
    Knob(
        "tempering",
        "Exponent of a scan's likelihood",
        _turned("localization.tempering", "0.1", 0.02, 0.05, 0.1, 0.2, 0.4, 1.0),
        "1.0",
        MARGIN,
        "Costs no time. Overlapping beams are not independent: with 1 the cloud is sure of a "
        "wrong place three times as often.",
        quick=True,
    ),
    Knob(
        "geometry",
        "A planar slice of the map against all of it",
        _turned("localization.geometry", "3d", "2d", "3d"),
        "2d",
        MARGIN,
        "A slice saves memory; it suits upright walls.",
    ),
    Knob(
        "elevations",
        "Elevations that a return is tried at, 3D",
        _turned("localization.elevations", "15", 1, 5, 9, 15, 25),
        None,
        MARGIN,
        "Too few lose the vehicle among objects above each other.",
    ),
    Knob(
        "resampling",
        "When particles are resampled",
        (
            _resampled("every update", 1, selective=False),
            Setting("when half is lost", {}),
            _resampled("every second update", 2, selective=False),
            _resampled("every fourth, when half is lost", 4, selective=True),
        ),
        "every second update",
        MARGIN,
        "Hardly costs time.",
    ),
    Knob(
        "step",
        "Way and time between updates, in times of 0.15 m (tank 0.03 m) and 1 s",
        _scaled("scale.step", 0.5, 1.0, 2.0, 4.0, 8.0),
        None,
        MARGIN,
        "Fewer updates save no time: the cloud spreads between them and needs more particles.",
    ),
    Knob(
        "cloud-error",
        "Error that the number of particles is chosen by (pf_err)",
        _turned("amcl.pf_err", "0.05", 0.01, 0.02, 0.05, 0.1, 0.2),
        "0.05",
        MARGIN,
        "Matters at an unknown start.",
    ),
    Knob(
        "search",
        "Poses that the first scan is tried at, for a start anywhere",
        _turned("localization.search_poses", "300000", 0, 30000, 100000, 300000, 1000000),
        "0",
        MARGIN,
        "Paid once, at an unknown start; without it hardly any such start succeeds.",
    ),
    Knob(
        "rivals",
        "A second cloud, tried every so much way, in times of 9.9 m (tank 2 m)",
        (
            Setting("never", {"scale.rivals": 0.0}),
            *_scaled("scale.rivals", 0.5, 1.0, 2.0, 4.0),
        ),
        "never",
        MARGIN,
        "The first to turn on a weak computer with a known start: without it a dive takes a sixth "
        "to a third of the time, but a vehicle at a wrong place is not found.",
    ),
    Knob(
        "sharpness",
        "Standard deviation of a hit, in times of two cells",
        _scaled("scale.sigma", 0.5, 1.0, 2.0, 4.0),
        None,
        MARGIN,
        "Sharper or blunter, the cloud takes longer to converge.",
    ),
    Knob(
        "drawing",
        "Power of the weights that particles are drawn by",
        _turned("localization.draw_exponent", "0.5", 0.25, 0.5, 0.75, 1.0),
        "1.0",
        MARGIN,
        "Costs no time; below 1 weak modes survive.",
    ),
)

WHOLES = (
    Setting("published", published_overrides()),
    *(Setting(name, values) for name in PROFILES if (values := profile_overrides(name))),
)
