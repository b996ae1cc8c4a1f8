import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene.material import MATERIALS, Material

WATER_MRAYL = 1.54


def test_lambert_coefficient_is_its_level_as_a_ratio() -> None:
    assert Material("x", -30.0).mu == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("name", "impedance_mrayl"),
    [
        ("machined_steel", 46.0),
        ("aluminium", 17.3),
        ("glass", 14.0),
        ("concrete", 8.0),
        ("sand", 3.3),
        ("pvc", 3.3),
        ("wood", 2.5),
        ("mud", 2.1),
        ("rubber", 1.8),
    ],
)
def test_reflections_follow_from_the_impedances(name: str, impedance_mrayl: float) -> None:
    expected = (impedance_mrayl - WATER_MRAYL) / (impedance_mrayl + WATER_MRAYL)
    assert MATERIALS[name].reflection == pytest.approx(expected, abs=0.01)


def test_materials_are_known_by_their_own_names() -> None:
    assert all(material.name == name for name, material in MATERIALS.items())


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"lambert_db": 3.0}, "lambert_db"),
        ({"lambert_db": float("nan")}, "lambert_db"),
        ({"lambert_db": -20.0, "reflection": 1.2}, "reflection"),
        ({"lambert_db": -20.0, "roughness_m": -1.0}, "roughness"),
        ({"lambert_db": -20.0, "slope_rad": 0.0}, "slope"),
    ],
)
def test_impossible_material_is_refused(wrong: dict[str, float], word: str) -> None:
    with pytest.raises(SceneError, match=word):
        Material("odd", **wrong)
