"""The panel of settings that may change while the daemon runs."""

import json
import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from mapperd.config.catalog import parameters

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle, ViserServer

__all__ = ["Control", "SettingsPanel", "control_of", "controls_of", "value_from"]

Kind = Literal["switch", "choice", "number", "text"]

_LIMIT = re.compile(r"(<=|>=|<|>) (-?[0-9.]+(?:e[+-]?[0-9]+)?)")


@dataclass(frozen=True, slots=True)
class Control:
    """Control of one setting.

    Attributes:
        name: name of the setting.
        section: its section.
        label: the rest of the name, with the unit.
        hint: description and allowed values.
        kind: kind of control; `text` accepts any value as JSON.
        value: value in force.
        low, high: limits of a number.
        whole: accepts only whole numbers.
        choices: allowed values of a choice.
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
    """Return the controls of live settings by section.

    Args:
        facts: all settings by name, as `mapperctl params --json` prints them.
        search: words that must occur in the name or description.
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
    """Return the control of one setting."""
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
    """Convert the contents of a control to the setting's value."""
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


_NAMES = tuple(parameters())
"""Settings in the order of the configuration."""

START, END = 1000, 1_000_000
"""Places in the tab: behind the search; behind settings that this version knows."""

NOTE_TIMEOUT_S = 6.0

SetSettings = Callable[[dict[str, Any]], Awaitable[dict[str, Any]]]


class SettingsPanel:
    """A form of controls for each section; use from the drawing thread.

    Nothing is sent while a user types: `Apply` sends the values that differ.

    Args:
        server: server of the page.
        tab: parent of the forms.
        apply: requests changes for a browser.
    """

    def __init__(
        self,
        server: "ViserServer",
        tab: "GuiTabHandle",
        apply: Callable[["ClientHandle | None", dict[str, Any]], object],
    ) -> None:
        self._server = server
        self._tab = tab
        self._apply = apply
        self._allowed = True
        self._facts: dict[str, Any] = {}
        self._controls: dict[str, tuple[Control, Any]] = {}
        self._forms: dict[str, Any] = {}
        with tab:
            self._note = server.gui.add_markdown("Waiting for the daemon's settings.")
            self._search = server.gui.add_text("Search", "", hint="Words of the name or the help")
        self._search.on_update(lambda _: self._find())

    def take(self, facts: Mapping[str, Any]) -> None:
        """Update settings: first all of them, then those that changed."""
        self._facts.update(facts)
        for section, controls in controls_of(facts).items():
            self._add_controls(section, controls)
        for name in facts:
            if name in self._controls:
                self._refresh(name)
        self._update_note()

    def may_change(self, allowed: bool) -> None:  # noqa: FBT001 the daemon's answer
        """Set whether the daemon accepts changes."""
        self._allowed = allowed
        self._update_note()

    def reset(self, names: Mapping[str, Any]) -> None:
        """Show the values in force of settings that were not changed."""
        for name in names:
            if name in self._controls:
                self._refresh(name)

    def _update_note(self) -> None:
        count = len(self._controls)
        if not self._allowed:
            self._note.content = f"{count} settings; this page may not change them."
        elif count:
            self._note.content = f"{count} live settings. Edit, then **Apply**."

    def _add_controls(self, section: str, controls: list[Control]) -> None:
        """Add the controls that are new; settings arrive in any order, in several messages."""
        if section not in self._forms:
            self._forms[section] = self._add_form(section)
        with self._forms[section]:
            for control in controls:
                if control.name not in self._controls:
                    self._controls[control.name] = (control, self._add(control))

    def _add_form(self, section: str) -> Any:  # noqa: ANN401 of viser
        gui = self._server.gui
        place = next((k for k, name in enumerate(_NAMES) if name.startswith(f"{section}.")), END)
        with self._tab:
            form = gui.add_form(section, expand_by_default=False, order=float(START + place))
        with form:
            button = gui.add_button(f"Apply {section}", color="cyan", order=float(2 * END))
        button.on_click(lambda event: self._send(event.client, section))
        form.on_submit(lambda event: self._send(event.client, section))
        return form

    def _add(self, control: Control) -> Any:  # noqa: ANN401 of viser
        """Add a control in its place; without limits, which a browser clamps to in silence."""
        gui, value, label = self._server.gui, control.value, control.label
        place = _NAMES.index(control.name) if control.name in _NAMES else END
        more: dict[str, Any] = {"hint": control.hint, "order": float(START + place)}
        if control.kind == "switch":
            return gui.add_checkbox(label, value, **more)
        if control.kind == "choice":
            return gui.add_dropdown(label, control.choices, initial_value=value, **more)
        if control.kind == "number":
            return gui.add_number(label, value, step=1 if control.whole else None, **more)
        return gui.add_text(label, value, **more)

    def _send(self, client: "ClientHandle | None", section: str) -> None:
        changes = {}
        for name, (control, handle) in self._controls.items():
            if control.section == section and handle.value != control.value:
                changes[name] = value_from(control, handle.value)
        if changes:
            self._apply(client, changes)

    def _refresh(self, name: str) -> None:
        control = control_of(name, self._facts[name])
        _, handle = self._controls[name]
        self._controls[name] = (control, handle)
        if handle.value != control.value:
            handle.value = control.value

    def _find(self) -> None:
        """Show the settings that match the search; called in a thread of viser."""
        found = controls_of(self._facts, self._search.value)
        names = {control.name for controls in found.values() for control in controls}
        for name, (_, handle) in self._controls.items():
            if handle.visible != (name in names):
                handle.visible = name in names
        for section, form in self._forms.items():
            form.visible = section in found
