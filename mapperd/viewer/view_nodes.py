"""Nodes of the scene that change in place: one made anew is not seen until it is drawn."""

from collections.abc import Callable
from typing import Any

__all__ = ["Nodes"]

STAY = 6
"""Looks after which a node goes that another one replaced: browsers draw that within them."""


class Nodes:
    """Nodes by name; of one thread, and nobody else changes or removes them."""

    def __init__(self) -> None:
        self._nodes: dict[str, Any] = {}
        self._replaced: dict[str, Any] = {}
        self._leaving: dict[str, tuple[int, Any]] = {}
        self._looks = 0

    def __contains__(self, name: str) -> bool:
        """Whether there is one that is not replaced."""
        return name in self._nodes

    @property
    def leaving(self) -> int:
        """Nodes that are replaced and are to go."""
        return len(self._replaced) + len(self._leaving)

    def put(self, name: str, make: Callable[..., Any], **properties: object) -> None:
        """Show a node with these properties.

        Args:
            name: of it.
            make: adds it to the scene, where it is not there yet; a name is for one kind only.
            properties: in the order in which they are told.
        """
        if name not in self._nodes:
            node = self._replaced.pop(name, None) or self._leaving.pop(name, (0, None))[1]
            if node is None:
                self._nodes[name] = make(name, **properties)
                return
            self._nodes[name] = node
        for key, value in properties.items():
            setattr(self._nodes[name], key, value)

    def remove(self, name: str) -> None:
        """It goes at once, if there is one."""
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()

    def replace(self, name: str) -> None:
        """It goes once the one in its place, which is there already, is drawn."""
        node = self._nodes.pop(name, None)
        if node is not None:
            self._leaving[name] = (self._looks, node)

    def replace_all(self) -> None:
        """All go once those in their places, which are still to come, are drawn."""
        self._replaced |= self._nodes
        self._nodes.clear()

    def look(self, *, complete: bool) -> None:
        """Remove what has been replaced for long enough; a few times a second.

        Args:
            complete: nothing is left to come.
        """
        self._looks += 1
        if complete:
            self._leaving |= {name: (self._looks, one) for name, one in self._replaced.items()}
            self._replaced.clear()
        for name, (since, node) in list(self._leaving.items()):
            if self._looks - since >= STAY:
                node.remove()
                del self._leaving[name]

    def clear(self) -> None:
        """All go at once."""
        leaving = (node for _, node in self._leaving.values())
        for node in (*self._nodes.values(), *self._replaced.values(), *leaving):
            node.remove()
        self._nodes.clear()
        self._replaced.clear()
        self._leaving.clear()
