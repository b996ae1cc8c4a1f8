"""What happens, and when: drawn from a number, so that it can be played again."""

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

__all__ = ["FAULTS", "Trouble", "trouble"]

FAULTS = {
    "cable_pulled": (1.0, 6.0),
    "sonar_rebooted": (1.0, 6.0),
    "odometry_silent": (0.5, 6.0),
    "broker_dead": (2.0, 15.0),
    "clock_stepped": (1.0, 20.0),
    "disk_full": (0.5, 4.0),
}
"""Least and longest time that each lasts, s."""

PAUSE_S = (0.2, 4.0)
STEP_S = 3600.0


@dataclass(frozen=True, slots=True)
class Trouble:
    """One thing that goes wrong.

    Attributes:
        begin_s, end_s: when, after the start.
        fault: which of `FAULTS`.
        amount: of a clock's step, s.
    """

    begin_s: float
    end_s: float
    fault: str
    amount: float = 0.0


def trouble(dice: int, duration_s: float) -> Iterator[Trouble]:
    """Everything that goes wrong, in order; troubles overlap, but none with its like.

    Args:
        dice: another number, another story.
        duration_s: of all; nothing lasts longer.
    """
    random = Random(dice)  # noqa: S311 a story, not a secret
    free_s = dict.fromkeys(FAULTS, 0.0)
    now_s = 0.0
    while True:
        now_s += random.uniform(*PAUSE_S)
        idle = sorted(fault for fault, end_s in free_s.items() if end_s <= now_s)
        fault = random.choice(idle or sorted(FAULTS))
        begin_s = max(now_s, free_s[fault])
        end_s = begin_s + random.uniform(*FAULTS[fault])
        if end_s > duration_s:
            return
        free_s[fault] = end_s
        yield Trouble(begin_s, end_s, fault, random.choice((-STEP_S, STEP_S)))
