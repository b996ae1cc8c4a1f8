from collections.abc import Callable

import numpy as np
import pytest
from sonar_sim.geometry.trajectory import Drift, Tour
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Surface

Load = Callable[..., Scenario]


def surfaces(scenario: Scenario) -> dict[str, Surface]:
    return {surface.name: surface for surface in scenario.scene.surfaces}


def test_object_is_turned_then_moved(load: Load) -> None:
    made = load(
        "objects: [{name: b, shape: {kind: box, size_m: [4, 1, 1]}, material: rock, "
        "position_m: [1, 2, -5], yaw_deg: 90, smooth: true}]"
    )
    box = surfaces(made)["b"]
    assert box.vertices_m.min(axis=0) == pytest.approx([0.5, 0.0, -5.5])
    assert box.vertices_m.max(axis=0) == pytest.approx([1.5, 4.0, -4.5])
    assert (box.material.name, box.smooth, box.motion) == ("rock", True, None)


def test_copies_are_numbered_and_stand_on_the_floor_each(load: Load) -> None:
    made = load(
        "terrain: {relief: {kind: procedural, depth_m: 5, relief_m: 0, slope: [0.1, 0]}, "
        "x_m: [-9, 9], y_m: [-3, 3]}\n"
        "objects: [{name: b, shape: {kind: box, size_m: [0.2, 0.2, 0.2]}, material: rock, "
        "position_m: [0, 0, 1], on_floor: true, repeat: {count: 3, step_m: [2, 0, 0]}}]"
    )
    heights = [surfaces(made)[f"b {k}"].vertices_m[:, 2].mean() for k in (1, 2, 3)]
    assert heights == pytest.approx([-4.0, -3.8, -3.6])


def test_what_the_floor_or_the_air_hides_is_left_out(load: Load, flat: str) -> None:
    made = load(
        flat + "objects: [{name: b, shape: {kind: box, size_m: [2, 2, 8]}, material: rock, "
        "position_m: [0, 0, -3], cell_m: 0.3}]"
    )
    box = surfaces(made)["b"].vertices_m[surfaces(made)["b"].faces]
    assert box[..., 2].max(axis=1).min() >= -5.0
    assert box[..., 2].min(axis=1).max() < 0.0
    floor = surfaces(made)["floor"]
    middles = floor.vertices_m[floor.faces].mean(axis=1)
    assert not np.any(np.abs(middles[:, :2]).max(axis=1) < 0.5)  # under the box
    assert np.any(np.abs(middles[:, :2]).max(axis=1) < 1.5)


def test_triangles_are_cut_to_their_cell(load: Load) -> None:
    made = load(
        "objects: [{name: b, shape: {kind: sheet, size_m: [2, 2]}, material: rock, "
        "position_m: [0, 0, -3], cell_m: 0.2}]"
    )
    sheet = surfaces(made)["b"]
    corners = sheet.vertices_m[sheet.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() <= 0.2
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() / 2.0 == pytest.approx(4.0)


@pytest.mark.parametrize(("cell_m", "by_halving"), [(0.2, 6912), (0.1, 27648)])
def test_cylinders_are_cut_into_fewer_triangles_than_halving_edges_leaves(
    load: Load, cell_m: float, by_halving: int
) -> None:
    made = load(
        "objects: [{name: c, shape: {kind: cylinder, radius_m: 1, height_m: 2, facets: 32}, "
        f"material: rock, position_m: [0, 0, -5], cell_m: {cell_m}}}]"
    )
    cylinder = surfaces(made)["c"]
    corners = cylinder.vertices_m[cylinder.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= cell_m
    assert len(cylinder.faces) < 0.8 * by_halving


def test_group_puts_its_parts_together(load: Load) -> None:
    made = load("""
objects:
  - name: cross
    material: rock
    position_m: [0, 0, -5]
    shape:
      kind: group
      parts:
        - {shape: {kind: box, size_m: [4, 0.2, 0.2]}}
        - {shape: {kind: box, size_m: [4, 0.2, 0.2]}, yaw_deg: 90, position_m: [0, 0, 1]}
""")
    cross = surfaces(made)["cross"]
    assert len(cross.faces) == 24
    assert cross.vertices_m.min(axis=0) == pytest.approx([-2.0, -2.0, -5.1])
    assert cross.vertices_m.max(axis=0) == pytest.approx([2.0, 2.0, -3.9])


def test_motions_begin_at_the_objects_place(load: Load) -> None:
    made = load("""
objects:
  - name: d
    shape: {kind: sphere, radius_m: 0.1}
    material: rock
    position_m: [1, 2, -3]
    yaw_deg: 30
    motion: {kind: drift, velocity_mps: [1, 0, 0]}
  - name: t
    shape: {kind: sphere, radius_m: 0.1}
    material: rock
    motion:
      kind: tour
      path: {heave_m: 0, waypoints: [{position_m: [0, 0, -4]}, {position_m: [6, 0, -4]}]}
targets:
  - name: fish
    position_m: [5, 0, -2]
    target_strength_db: -40
    motion: {kind: drift, velocity_mps: [0, 1, 0]}
""")
    drifting, touring = surfaces(made)["d"], surfaces(made)["t"]
    assert isinstance(drifting.motion, Drift)
    assert isinstance(touring.motion, Tour)
    assert drifting.vertices_at_m(2.0).mean(axis=0) == pytest.approx([3.0, 2.0, -3.0])
    assert touring.vertices_at_m(0.0).mean(axis=0)[2] == pytest.approx(-4.0)
    assert made.scene.targets[0].position_at_m(3.0) == pytest.approx([5.0, 3.0, -2.0])
