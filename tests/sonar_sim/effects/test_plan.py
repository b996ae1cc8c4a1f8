"""The plan: rules first, then what the user wants."""

import pytest
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectPlan, EffectSelection, EffectWarning
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.errors import EffectError
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.scene import Scene
from sonar_sim.simulator import Simulator

from tests.sonar_sim.effects.previews import LOUD, floor, pose, view_of

NAMES = """
spreading absorption sound_speed refraction turbidity bubbles azimuth_pattern side_lobes
vertical_pattern all_elevations bearing_table near_field range_spread shadows lambert specular
speckle volume reverberation surface_reverberation bottom_reverberation multipath motion doppler
noise ring_down crosstalk interference tvg gain saturation gamma quantisation
"""


def plan(choice: str | dict[str, bool]) -> EffectPlan:
    return EffectPlan.make(view_of(floor()), EffectSelection.read(choice), Tolerance())


def test_every_effect_of_the_catalogue_has_its_module() -> None:
    assert set(EFFECTS) == set(NAMES.split())
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert effect.formula
        assert effect.source
        assert effect.rule
        assert effect.needs


def test_all_and_none_are_what_their_names_mean() -> None:
    assert set(plan("all").names) == set(EFFECTS)
    assert plan("none").names == ()


def test_a_list_computes_just_what_it_names() -> None:
    assert plan("tvg,spreading").names == ("spreading", "tvg")


def test_a_sign_overrules_the_rule() -> None:
    auto = plan("auto")
    assert "noise" in auto.names
    assert "doppler" not in auto.names
    changed = plan("auto,-noise,+doppler")
    assert set(changed.names) == (set(auto.names) - {"noise"}) | {"doppler"}
    assert plan({"noise": False, "doppler": True}).names == changed.names


def test_an_unknown_effect_is_named() -> None:
    with pytest.raises(EffectError, match="no effect 'nois'"):
        EffectSelection.read("auto,-nois")
    with pytest.raises(EffectError, match="no effect 'echo'"):
        EffectSelection.read({"echo": True})


def test_a_missed_effect_is_warned_of_once() -> None:
    simulator = Simulator(Scene((floor(),)), LOUD, effects="auto,-absorption")
    with pytest.warns(EffectWarning, match=r"absorption is switched off, but .* 2 alpha R"):
        simulator.ping(pose())
    simulator.ping(pose())  # warnings are errors here


def test_nothing_configured_is_the_default_physics() -> None:
    view = view_of(floor())
    bare = plan("none").physics(view)
    assert bare.silent == {"floor"}
    bare.silent = frozenset()
    default = Physics()
    assert all(getattr(bare, n) == getattr(default, n) for n in Physics.__slots__)


@pytest.mark.slow
def test_each_effect_changes_the_settings() -> None:
    view = view_of(floor())
    idle = {
        "sound_speed",
        "refraction",
        "turbidity",
        "bubbles",
        "interference",
        "multipath",
        "surface_reverberation",
        "near_field",
    }  # this scene has nothing for them
    for name in set(EFFECTS) - idle:
        bare, one = (plan(choice).physics(view) for choice in ("none", name))
        assert any(getattr(bare, n) != getattr(one, n) for n in Physics.__slots__), name


def test_a_tolerance_that_decides_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="above zero"):
        Tolerance(level_db=0.0)
    with pytest.raises(ValueError, match="share"):
        Tolerance(share=1.0)
