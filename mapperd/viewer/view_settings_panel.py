"""The bar of settings that may change while the daemon runs."""

from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any

from mapperd.viewer.settings import Control, control_of, controls_of, value_from

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle, ViserServer

__all__ = ["SettingsPanel"]

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
