"""`amcl.restore_defaults`: a request, not a state."""

from collections.abc import Mapping
from typing import Any

import msgspec

from mapperd.config.catalog import parameters
from mapperd.config.tree import Amcl
from mapperd.errors import ConfigError

__all__ = ["RESTORE", "restored_changes"]

RESTORE = "amcl.restore_defaults"


def restored_changes(changes: Mapping[str, Any], start: Amcl) -> dict[str, Any]:
    """The changes that a request means.

    Args:
        changes: plain values by name.
        start: the section at the program's start.

    Returns:
        The changes as they are; with `amcl.restore_defaults` true, all settings of `amcl` that may
        change while running at their values of the start, the request itself taken back.

    Raises:
        ConfigError: it is asked for together with another change of `amcl`.
    """
    if changes.get(RESTORE) is not True:
        return dict(changes)
    others = [name for name in changes if name.startswith("amcl.") and name != RESTORE]
    if others:
        raise ConfigError(
            f"$.{RESTORE}: undoes {', '.join(others)}; allowed: alone", f"$.{RESTORE}"
        )
    values = {f"amcl.{field}": value for field, value in msgspec.to_builtins(start).items()}
    live = {name: value for name, value in values.items() if parameters()[name].dynamic}
    return dict(changes) | live | {RESTORE: False}
