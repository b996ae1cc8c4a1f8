"""Everything about settings in plain values, for those who ask."""

from collections.abc import Callable, Sequence
from typing import Any

from mapperd.config.catalog import Parameter, parameters, value_of
from mapperd.config.tree import Config

__all__ = ["chosen", "facts_of"]


def facts_of(
    config: Config, origin_of: Callable[[str], str], names: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Value, default, unit, limits, origin and meaning of settings, by name.

    Args:
        config: the settings.
        origin_of: who said a setting.
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
