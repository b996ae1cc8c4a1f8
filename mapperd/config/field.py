"""How a setting says what it is."""

from typing import Any

from msgspec import Meta

__all__ = ["rule"]


def rule(description: str, unit: str = "", *, live: bool = False, **limits: float | str) -> Meta:
    """Say what a field means, its unit, its limits, and whether it may change at run time."""
    known: dict[str, Any] = {**limits, "extra": {"unit": unit, "dynamic": live}}
    return Meta(description=description, **known)
