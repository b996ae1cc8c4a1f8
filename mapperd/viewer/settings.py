"""Which control a setting has on the page, and what is sent when somebody uses it."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["Control", "control_of", "controls_of", "value_from"]

Kind = Literal["switch", "choice", "number", "text"]

_LIMIT = re.compile(r"(<=|>=|<|>) (-?[0-9.]+(?:e[+-]?[0-9]+)?)")


@dataclass(frozen=True, slots=True)
class Control:
    """One setting that may change while the daemon runs.

    Attributes:
        name: of the setting.
        section: the first part of it.
        label: the rest, with the unit.
        hint: what it means and what is allowed.
        kind: of control; `text` takes any value as JSON.
        value: in force.
        low, high: limits of a number, both allowed or just not.
        whole: only whole numbers.
        choices: of a choice.
    """

    name: str
    section: str
    label: str
    hint: str
    kind: Kind
    value: Any
    low: float | None = None
    high: float | None = None
    whole: bool = False
    choices: tuple[str, ...] = ()


def controls_of(facts: Mapping[str, Any], search: str = "") -> dict[str, list[Control]]:
    """Sections and their controls: of the settings that may change and whose facts hold all words.

    Args:
        facts: of all settings, by name: docs/control.md, `params`.
        search: words.
    """
    words = search.lower().split()
    sections: dict[str, list[Control]] = {}
    for name, fact in facts.items():
        if not (isinstance(fact, Mapping) and fact.get("dynamic")):
            continue
        text = f"{name} {fact.get('description', '')}".lower()
        if all(word in text for word in words):
            control = control_of(name, fact)
            sections.setdefault(control.section, []).append(control)
    return sections


def control_of(name: str, fact: Mapping[str, Any]) -> Control:
    """The control of one setting."""
    section, _, rest = name.partition(".")
    allowed, unit, value = str(fact.get("allowed", "")), str(fact.get("unit", "")), fact["value"]
    label = f"{rest or name} ({unit})" if unit and _is_number(value) else rest or name
    hint = f"{name}: {fact.get('description', '')} {allowed}; default {_shown(fact.get('default'))}"
    if isinstance(value, bool):
        return Control(name, section, label, hint, "switch", value)
    if _is_number(value):
        low, high = _limits(allowed)
        whole = allowed.startswith("a whole number")
        return Control(name, section, label, hint, "number", value, low, high, whole)
    choices = tuple(allowed.split(" or "))
    if isinstance(value, str) and value in choices:
        return Control(name, section, label, hint, "choice", value, choices=choices)
    return Control(name, section, label, hint, "text", _shown(value))


def value_from(control: Control, entered: Any) -> Any:  # noqa: ANN401 whatever the setting takes
    """The value that is sent for what stands in a control."""
    if control.kind == "number":
        return round(entered) if control.whole else float(entered)
    if control.kind != "text":
        return entered
    try:
        return json.loads(entered)
    except ValueError:
        return entered


def _shown(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _limits(allowed: str) -> tuple[float | None, float | None]:
    low = high = None
    for sign, number in _LIMIT.findall(allowed):
        if sign.startswith(">"):
            low = float(number)
        else:
            high = float(number)
    return low, high
