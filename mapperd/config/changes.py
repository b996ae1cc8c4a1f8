"""What differs between two trees of settings, by name."""

from collections.abc import Mapping
from typing import Any

import msgspec

from mapperd.config.catalog import parameters, value_of
from mapperd.config.loader import config_of
from mapperd.config.tree import Config

__all__ = ["changes_between", "with_values"]


def changes_between(before: Config, after: Config) -> dict[str, Any]:
    """Plain values, by name, of the settings that are other than before."""
    return {
        name: value
        for name in parameters()
        if (value := value_of(after, name)) != value_of(before, name)
    }


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """Settings of which some have other values, by name.

    Raises:
        ConfigError: they are not allowed.
    """
    tree = msgspec.to_builtins(config)
    for name, value in values.items():
        *sections, leaf = name.split(".")
        section = tree
        for part in sections:
            section = section[part]
        section[leaf] = value
    return config_of(tree, "")
