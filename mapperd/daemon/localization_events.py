"""Notices what changes in localization, and says it as events."""

from mapperd.events import EventLog, Severity
from mapperd.localization.report import map_name_of, state_of
from mapperd.localization.status import LocalizationFacts

__all__ = ["LocalizationWatch"]

TEXTS = {
    "localized": (Severity.NOTICE, "the vehicle is localized"),
    "ambiguous": (Severity.WARNING, "the vehicle may be at more than one place"),
    "lost": (Severity.WARNING, "localization is lost: most of the weight is elsewhere"),
}


class LocalizationWatch:
    """Compares facts with those before; one thread at a time.

    Args:
        events: is told.
    """

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self._map = ""
        self._state = ""
        self._level = "OK"

    def told(self, facts: LocalizationFacts) -> None:
        """Look at new facts."""
        name = map_name_of(facts)
        if name != self._map:
            self._map = name
            self._events.add(
                Severity.NOTICE, "map_loaded", f"localizing on {self._map}", map=self._map
            )
        self._look_at_state(facts)
        self._look_at_level(facts)

    def _look_at_state(self, facts: LocalizationFacts) -> None:
        state = state_of(facts)
        before, self._state = self._state, state
        if state == before or state not in TEXTS or facts.belief is None:
            return
        severity, text = TEXTS[state]
        best = facts.belief.best
        where = f"x {best.x_m:.2f} m, y {best.y_m:.2f} m, {best.yaw_rad:.3f} rad"
        share = facts.belief.elsewhere
        self._events.add(severity, state, f"{text}; {where} at best", elsewhere=share)

    def _look_at_level(self, facts: LocalizationFacts) -> None:
        diagnosis = facts.diagnosis
        if diagnosis.level == self._level:
            return
        self._level = diagnosis.level
        bad = self._level == "WARN"
        severity = Severity.WARNING if bad else Severity.NOTICE
        text = f"localization: {diagnosis.text}"
        self._events.add(severity, "localization_std", text, level=self._level)
