"""One estimate of one sender told by several messages: the best of them is taken.

An autopilot may send its attitude as angles and as a quaternion. Both in one series would only
make it noisier, and out of order.
"""

from dataclasses import replace
from typing import Any

from mapperd.odometry.records import Odometry

__all__ = ["Precedence"]

SILENCE_NS = 2 * 10**9
"""After so long without the better message the next best will do."""

QUANTITIES = {
    "position_m": "position",
    "geo": "position",
    "pose_covariance": "position",
    "velocity_mps": "velocity",
    "velocity_map_mps": "velocity",
    "velocity_east_north_mps": "velocity",
    "twist_covariance": "velocity",
    "map_q_base": "attitude",
    "heading_rad": "attitude",
    "rate_radps": "attitude",
}
"""Of the fields that several messages tell."""


class Precedence:
    """Remembers which message tells each quantity.

    Args:
        order: messages, best first.
    """

    def __init__(self, order: tuple[str, ...]) -> None:
        self._rank = {name: rank for rank, name in enumerate(order)}
        self._leaders: dict[str, tuple[int, int | None]] = {}

    def filtered(self, name: str, odometry: Odometry, arrival_ns: int | None) -> Odometry | None:
        """The record without what a better message tells; None when nothing is left."""
        told = {
            field: quantity
            for field, quantity in QUANTITIES.items()
            if getattr(odometry, field) is not None
        }
        if name not in self._rank or not told:
            return odometry
        better = {
            quantity
            for quantity in set(told.values())
            if not self._leads(
                quantity,
                self._rank[name],
                # A heading alone is the attitude of a level vehicle: it follows on from no other.
                None if quantity == "attitude" and odometry.map_q_base is None else arrival_ns,
            )
        }
        without: dict[str, Any] = {field: None for field, q in told.items() if q in better}
        if not without:
            return odometry
        rest = replace(odometry, **without)
        return rest if len(without) < len(told) else None

    def _leads(self, quantity: str, rank: int, arrival_ns: int | None) -> bool:
        """Whether this message tells the quantity now; remembers it, if so."""
        leader, heard_ns = self._leaders.get(quantity, (rank, None))
        silent = (
            arrival_ns is not None and heard_ns is not None and arrival_ns - heard_ns > SILENCE_NS
        )
        if rank > leader and not silent:
            return False
        self._leaders[quantity] = (rank, arrival_ns)
        return True
