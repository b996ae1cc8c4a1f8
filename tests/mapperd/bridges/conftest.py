"""Bridges, with no settings but those that are given."""

from tests.support.mapperctl import no_settings

__all__ = ["no_settings"]
