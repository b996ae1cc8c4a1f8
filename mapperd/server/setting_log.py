"""Settings for many clients: who has heard up to a number is told the newest of what came after."""

from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

import msgspec

from mapperd.wire.control_messages import plain

__all__ = ["SettingLog"]

_ENCODER = msgspec.msgpack.Encoder(enc_hook=plain)


class SettingLog:
    """Facts of settings in the order in which they changed last; each stands in it once.

    Args:
        facts: of all settings, by name.

    Attributes:
        last: number of the newest change.
    """

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.last = 0
        self._facts: dict[str, msgspec.Raw] = {}
        self._numbers: dict[str, int] = {}
        self._order: list[tuple[int, str]] = []
        self.put(facts)

    def put(self, facts: Mapping[str, Any]) -> None:
        """These are others than before."""
        for name, fact in facts.items():
            self.last += 1
            self._facts[name] = msgspec.Raw(_ENCODER.encode(fact))
            self._numbers[name] = self.last
        self._order = sorted((number, name) for name, number in self._numbers.items())

    def since(self, number: int, most_bytes: int) -> tuple[int, dict[str, msgspec.Raw]]:
        """The next facts after a number, about so many bytes of them, at least one.

        Returns:
            The number up to which all is told then, and the facts by name.
        """
        at = bisect_right(self._order, number, key=lambda entry: entry[0])
        told: dict[str, msgspec.Raw] = {}
        size = 0
        while at < len(self._order) and (not told or size < most_bytes):
            number, name = self._order[at]
            told[name] = self._facts[name]
            size += len(name) + len(bytes(self._facts[name]))
            at += 1
        return number, told
