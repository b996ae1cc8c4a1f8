"""Differences between two trees of settings, and settings as plain values."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from mapperd.config.aliases import ALIASES
from mapperd.config.catalog import Parameter, parameters, value_of
from mapperd.config.loader import config_of
from mapperd.config.tree import Config

__all__ = ["changes_between", "chosen", "facts_of", "with_values"]


def changes_between(before: Config, after: Config) -> dict[str, Any]:
    """Plain values, by name, of the settings that are other than before."""
    return {
        name: value
        for name in parameters()
        if (value := value_of(after, name)) != value_of(before, name)
    }


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """Settings of which some have other values, by name or by another name of the setting.

    Raises:
        ConfigError: they are not allowed.
    """
    tree = msgspec.to_builtins(config)
    for name, value in values.items():
        *sections, leaf = ALIASES.get(name, name).split(".")
        section = tree
        for part in sections:
            section = section[part]
        section[leaf] = value
    return config_of(tree, "")


def facts_of(
    config: Config, origin_of: Callable[[str], str], names: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Value, default, unit, limits, origin and meaning of settings, by name.

    Args:
        config: the settings.
        origin_of: returns where a value comes from.
        names: settings or sections; none is all.
    """
    return {
        parameter.name: {
            "value": value_of(config, parameter.name),
            "default": parameter.default,
            "unit": parameter.unit,
            "allowed": parameter.allowed,
            "dynamic": parameter.dynamic,
            "origin": origin_of(parameter.name),
            "description": parameter.description,
        }
        for parameter in chosen(names)
    }


def chosen(names: Sequence[str]) -> list[Parameter]:
    """The settings of these names and sections, in the order of the tree; of none, all."""
    return [
        parameter
        for name, parameter in parameters().items()
        if not names or any(name == one or name.startswith(f"{one}.") for one in names)
    ]
