"""The bar of settings that may change while the daemon runs."""

import json
import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle, ViserServer

__all__ = ["Control", "SettingsPanel", "control_of", "controls_of", "value_from"]

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


SAID_S = 6.0

SetSettings = Callable[[dict[str, Any]], Awaitable[dict[str, Any]]]


class SettingsPanel:
    """Controls of settings, a form for each section; of the thread that draws.

    Nothing is sent while somebody types: `Apply` sends what differs from what is in force.

    Args:
        server: of the page.
        tab: where it stands.
        apply: has changes done; said who wants them.
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
            self._note = server.gui.add_markdown("Settings come with the link.")
            self._search = server.gui.add_text("Search", "", hint="Words of the name or the help")
        self._search.on_update(lambda _: self._find())

    def take(self, facts: Mapping[str, Any]) -> None:
        """Facts of settings: the first time of all, then of those that changed."""
        self._facts.update(facts)
        for section, controls in controls_of(self._facts).items():
            if section not in self._forms:
                self._add_form(section, controls)
        for name in facts:
            if name in self._controls:
                self._refresh(name)
        self._say()

    def may_change(self, allowed: bool) -> None:  # noqa: FBT001 as the daemon says it
        """Whether a change would be heeded at all."""
        self._allowed = allowed
        self._say()

    def reset(self, names: Mapping[str, Any]) -> None:
        """These were not changed: their controls show what is in force."""
        for name in names:
            if name in self._controls:
                self._refresh(name)

    def _say(self) -> None:
        count = len(self._controls)
        if not self._allowed:
            self._note.content = f"{count} settings; this page may look and change nothing."
        elif count:
            self._note.content = f"{count} settings that may change now. Enter, then **Apply**."

    def _add_form(self, section: str, controls: list[Control]) -> None:
        gui = self._server.gui
        with self._tab, gui.add_form(section, expand_by_default=False) as form:
            for control in controls:
                self._controls[control.name] = (control, self._add(control))
            button = gui.add_button(f"Apply {section}", color="cyan")
        self._forms[section] = form
        names = [control.name for control in controls]
        button.on_click(lambda event: self._send(event.client, names))
        form.on_submit(lambda event: self._send(event.client, names))

    def _add(self, control: Control) -> Any:  # noqa: ANN401 of viser
        gui, value, hint = self._server.gui, control.value, control.hint
        if control.kind == "switch":
            return gui.add_checkbox(control.label, value, hint=hint)
        if control.kind == "choice":
            return gui.add_dropdown(control.label, control.choices, initial_value=value, hint=hint)
        if control.kind == "number":
            return gui.add_number(
                control.label,
                value,
                min=control.low,
                max=control.high,
                step=1 if control.whole else None,
                hint=hint,
            )
        return gui.add_text(control.label, value, hint=hint)

    def _send(self, client: "ClientHandle | None", names: list[str]) -> None:
        changes = {}
        for name in names:
            control, handle = self._controls[name]
            if handle.value != control.value:
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
        """Show what the search finds; of a thread of viser, which changes nothing of ours."""
        found = controls_of(self._facts, self._search.value)
        names = {control.name for controls in found.values() for control in controls}
        for name, (_, handle) in self._controls.items():
            if handle.visible != (name in names):
                handle.visible = name in names
        for section, form in self._forms.items():
            form.visible = section in found
