"""Part numbers."""

from __future__ import annotations

import pytest

from oculus_driver.models import C550D, M370S, M750D, M1200D, M3000D, UNKNOWN, Family, model_of


@pytest.mark.parametrize(
    ("part_number", "name", "family"),
    [
        (1032, "M750d", M750D),
        (1042, "M1200d", M1200D),
        (1041, "M370s", M370S),
        (2203, "M3000d", M3000D),
        (4713, "C550d", C550D),
        (0, "part 0", UNKNOWN),
        (65535, "part 65535", UNKNOWN),
    ],
)
def test_a_part_number_has_a_model(part_number: int, name: str, family: Family) -> None:
    model = model_of(part_number)
    assert (model.part_number, model.name, model.family) == (part_number, name, family)


def test_the_m370s_has_one_mode() -> None:
    assert M370S.max_range_m == (200.0, None)
