"""Settings for people: a line each."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from mapperd.cli.mapperctl.errors import plain

__all__ = ["params_lines"]


def params_lines(facts: Mapping[str, Mapping[str, Any]], *, origin: bool) -> Iterator[str]:
    """One line a setting: name, value, unit, and who said it.

    Args:
        facts: of `mapperd.config.config_facts.facts_of`.
        origin: tell who said it.
    """
    for name, fact in facts.items():
        unit = f" {fact['unit']}" if _is_measure(fact) else ""
        said = f"  # {plain(fact['origin'])}" if origin else ""
        yield f"{name} = {json.dumps(fact['value'])}{unit}{said}"


def _is_measure(fact: Mapping[str, Any]) -> bool:
    """A number with a unit; of a text the unit says what it is, of a ratio its scale."""
    default, unit = fact["default"], fact["unit"]
    number = isinstance(default, int | float) and not isinstance(default, bool)
    return number and not unit[:1].isdigit() and unit != ""
