"""A validation case: what is known, what the simulator gives, and how near it must be."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class ValidationCheck:
    """One number.

    Attributes:
        what: the number, with its unit.
        expected: by theory or measurement.
        got: from the simulator.
        tolerance: largest allowed difference.
    """

    what: str
    expected: float
    got: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether it is near enough; false for NaN."""
        return abs(self.got - self.expected) <= self.tolerance


@dataclass(frozen=True, slots=True)
class ValidationResult:
    """One case, worked out.

    Attributes:
        name: such as "V2 range slopes".
        source: of what is expected.
        checks: the numbers.
        draw: draws the case into axes.
    """

    name: str
    source: str
    checks: tuple[ValidationCheck, ...]
    draw: "Callable[[Axes], None]"
