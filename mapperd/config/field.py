"""Metadata of settings: description, unit, limits."""

from typing import Any

from msgspec import Meta

__all__ = ["rule"]


def rule(description: str, unit: str = "", *, live: bool = False, **limits: float | str) -> Meta:
    """Annotate a field with its description, unit, limits, and whether it may change live."""
    known: dict[str, Any] = {**limits, "extra": {"unit": unit, "dynamic": live}}
    return Meta(description=description, **known)
