import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.geometry.trajectory import Drift
from sonar_sim.scene.material import MATERIALS
from sonar_sim.scene.scene import Bubbles, CloudSpec, PointTarget, Scene, Sea, Surface

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 1, 2], [0, 1, 3]])
SAND, ROCK = MATERIALS["sand"], MATERIALS["rock"]


def test_triangles_come_surface_after_surface_with_their_material() -> None:
    far = Surface("far", CORNERS + 5.0, FACES[:1], ROCK)
    scene = Scene((Surface("near", CORNERS, FACES, SAND), far))
    assert scene.triangles_m.shape == (3, 3, 3)
    assert scene.face_surface.tolist() == [0, 0, 1]
    assert scene.face_mu == pytest.approx([SAND.mu, SAND.mu, ROCK.mu])
    assert scene.triangles_m[2, 0].tolist() == [5.0, 5.0, 5.0]


def test_empty_scene_has_no_triangles() -> None:
    scene = Scene()
    assert scene.triangles_m.shape == (0, 3, 3)
    assert scene.face_mu.shape == (0,)


def test_moving_surface_is_where_its_motion_puts_it_and_no_part_of_the_saved_truth(
    tmp_path: Path,
) -> None:
    motion = Drift(position_m=(1.0, 0.0, 0.0), yaw_deg=90.0, velocity_mps=(0.0, 2.0, 0.0))
    moving = Surface("moving", CORNERS, FACES, SAND, motion=motion)
    scene = Scene((Surface("still", CORNERS, FACES, SAND), moving))
    assert scene.triangles_at_m(3.0)[2, 1] == pytest.approx([1.0, 7.0, 0.0])
    scene.save(tmp_path / "truth.ply")
    assert len(trimesh.load_mesh(tmp_path / "truth.ply").faces) == 2


def test_target_moves_about_its_motions_origin() -> None:
    still = PointTarget("a", (1.0, 2.0, 3.0), -30.0)
    assert still.position_at_m(9.0).tolist() == [1.0, 2.0, 3.0]
    motion = Drift(position_m=(5.0, 0.0, 0.0), yaw_rate_dps=90.0)
    assert PointTarget("b", (1.0, 0.0, 0.0), -30.0, motion).position_at_m(1.0) == pytest.approx(
        [5.0, 1.0, 0.0]
    )


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.where(CORNERS == 1.0, np.nan, CORNERS), FACES, "vertex 1"),
        (np.where(CORNERS == 1.0, np.inf, CORNERS), FACES, "vertex 1"),
        (CORNERS, FACES + 2, "does not exist"),
        (CORNERS, FACES - 1, "does not exist"),
        (CORNERS[:, :2], FACES, r"not \(V, 3\)"),
        (CORNERS, FACES.ravel(), r"not \(F, 3\)"),
    ],
)
def test_broken_surface_is_refused_by_name(
    vertices: np.ndarray, faces: np.ndarray, words: str
) -> None:
    with pytest.raises(SceneError, match=f"'hull'.*{words}"):
        Surface("hull", vertices, faces, SAND)


def test_cloud_needs_a_volume() -> None:
    with pytest.raises(SceneError, match="below"):
        CloudSpec("c", (0.0, 0.0, 0.0), (1.0, 0.0, 1.0), Bubbles(1e-3, 10.0))


def test_scene_can_be_sent_to_another_process() -> None:
    surface = Surface("s", CORNERS, FACES, SAND, motion=Drift(velocity_mps=(1.0, 0.0, 0.0)))
    sent = pickle.loads(pickle.dumps(Scene((surface,))))  # noqa: S301 our own bytes
    assert np.array_equal(sent.triangles_at_m(2.0), Scene((surface,)).triangles_at_m(2.0))


def test_a_saved_sea_is_there_where_it_was_seen(tmp_path: Path) -> None:
    seen = np.array([[0.2, 0.2, 0.0], [0.3, 0.4, 0.0], [-1.4, 3.1, 0.0], [5.0, 5.0, -2.0]])
    path = tmp_path / "scene.ply"
    Scene(sea=Sea()).save(path, seen)
    mesh = trimesh.load_mesh(path, process=False)
    assert mesh.area == pytest.approx(2 * 0.25)
    assert np.all(mesh.vertices[:, 2] == 0.0)
    low_m, high_m = mesh.triangles.min(axis=1), mesh.triangles.max(axis=1)
    inside = np.all((low_m <= seen[:, None]) & (seen[:, None] <= high_m), axis=2).any(axis=1)
    assert inside.tolist() == [True, True, True, False]
