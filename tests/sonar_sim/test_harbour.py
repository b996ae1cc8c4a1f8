import numpy as np
from sonar_sim.harbour import floor_height_m, harbour


def test_harbour_has_all_its_surfaces_and_nothing_above_water() -> None:
    scene = harbour()
    names = [surface.name for surface in scene.surfaces]
    assert names[:3] == ["floor", "quay", "wreck"]
    assert sum(name.startswith("pile") for name in names) == 4
    assert scene.triangles_m[..., 2].max() <= 1e-9
    assert len(scene.face_mu) == len(scene.triangles_m)


def test_harbour_is_the_same_every_time() -> None:
    assert np.array_equal(harbour().triangles_m, harbour().triangles_m)


def test_wreck_keeps_only_faces_that_reach_above_the_floor() -> None:
    wreck = next(s for s in harbour().surfaces if s.name == "wreck")
    corners = wreck.vertices_m[wreck.faces]
    above = corners[..., 2] - floor_height_m(corners[..., 0], corners[..., 1])
    assert np.all(above.max(axis=1) >= 0.0)
    assert len(wreck.faces) > 1000
