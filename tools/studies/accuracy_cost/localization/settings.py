"""The settings of a localized dive: the measured profile, and what a study turns in it."""

from collections.abc import Mapping
from typing import Any

import msgspec
import yaml

from mapperd.config.loader import config_of
from mapperd.config.tree import Config, OctreeConfig
from studies.accuracy_cost.study import Value
from studies.localization.runs import settings
from studies.localization.world import Place
from studies.report import ROOT

__all__ = ["SCALES", "config_for", "profile_overrides", "published_overrides"]

CONFIG = ROOT / "config"
PROFILE = CONFIG / "localization.yaml"
"""Of the harbour; `dive_runs.settings` has it for every place, and a test holds both equal."""

SCALES = {
    "scale.cells": ("octree.voxel_resolution",),
    "scale.step": ("amcl.update_min_d", "localization.update_max_interval"),
    "scale.sigma": ("amcl.laser_sigma_hit",),
    "scale.rivals": ("localization.rival_interval",),
}
"""Factors that a study turns, and the settings that they multiply: these differ between places."""


def config_for(place: Place, overrides: Mapping[str, Value], seed: int) -> Config:
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

    Settings that the published filter does not have are off by their defaults.
    """
    profile = yaml.safe_load(PROFILE.read_text(encoding="utf-8"))
    defaults = msgspec.to_builtins(Config())
    said: dict[str, Value] = {
        f"{section}.{name}": defaults[section][name]
        for section in ("amcl", "localization")
        for name in profile[section]
    }
    return said | {"localization.geometry": "2d"}


def profile_overrides(name: str) -> dict[str, Value]:
    """What a profile in `config/` says of localization; nothing where there is no such file."""
    path = CONFIG / f"{name}.yaml"
    if not path.exists():
        return {}
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        f"{section}.{key}": value
        for section in ("amcl", "localization")
        for key, value in (tree.get(section) or {}).items()
    }
