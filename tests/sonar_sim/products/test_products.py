from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from sonar_sim.errors import SonarSimError
from sonar_sim.products import PingProducts, ProductRenderer, write_products
from sonar_sim.products.arrays import lookup_pixels, pixel_cells, raw_scan, surface_labels
from sonar_sim.products.images import decoded_ping, depth_picture, label_picture, normal_picture
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.receiver.gain import noise_level_db
from sonar_sim.scene.scene import Scene

WALL, BOARD = 0, 1


@pytest.fixture(scope="module")
def folder(sounding: PingProducts, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("products")
    write_products(path, sounding)
    return path


def test_every_product_is_written_and_readable(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    stems = ("polar", "depth", "normals", "snr", "snr_polar", "raw_scan", "fan", "truth")
    assert names == {f"{stem}.png" for stem in stems} | {
        "polar.npz",
        "camera.npz",
        "snr.npz",
        "raw_scan.npz",
        "truth.npz",
        "points.ply",
        "camera_info.yaml",
    }
    assert all(
        cv2.imread(str(path), cv2.IMREAD_UNCHANGED) is not None for path in folder.glob("*.png")
    )


def test_the_polar_ping_is_the_image_with_its_places(folder: Path, sounding: PingProducts) -> None:
    polar = np.load(folder / "polar.npz")
    assert np.array_equal(polar["image"], sounding.image)
    assert polar["bearings_rad"][[0, -1]] == pytest.approx(np.radians([-65.0, 65.0]))
    assert polar["ranges_m"][0] == pytest.approx(polar["range_resolution_m"] / 2.0)
    assert polar["map_T_sonar"] == pytest.approx(np.eye(4))


def test_camera_truth_knows_range_surface_material_and_incidence(folder: Path) -> None:
    camera = np.load(folder / "camera.npz")
    row, column = 30, 57
    assert camera["surface"][row, column] == BOARD
    assert camera["surface_names"][BOARD] == "board"
    assert camera["material_names"][camera["material"][row, column]] == "rock"
    assert camera["depth_m"][row, column] == pytest.approx(3.0)
    cosine = np.cos(camera["incidence_rad"][row, column])
    assert camera["range_m"][row, column] == pytest.approx(3.0 / cosine, rel=1e-5)
    assert camera["surface"][0, 0] == -1
    assert camera["material"][0, 0] == -1
    assert np.isnan(camera["elevation_rad"][0, 0])


def test_ping_truth_knows_both_boards(folder: Path) -> None:
    truth = np.load(folder / "truth.npz")
    board = truth["surface"] == BOARD
    assert set(np.unique(truth["surface"])) == {-1, WALL, BOARD}
    assert np.all(np.abs(truth["range_m"][board] - 3.15) < 0.2)
    assert truth["normal"][board][:, 0] == pytest.approx(-1.0)
    assert truth["elevation_rad"].shape == truth["range_m"].shape


def test_a_pixel_s_cell_is_that_of_its_range_and_cone(sounding: PingProducts) -> None:
    row, beam, inside = pixel_cells(sounding.view, sounding.sonar)
    bearing = np.arcsin(
        (np.arange(sounding.sonar.beams) - (sounding.sonar.beams - 1) / 2.0)
        * sounding.sonar.sine_pitch
    )
    board = inside & (sounding.view.surface == BOARD)
    assert bearing[beam[board]].min() > 0.0
    away = (row[board] + 0.5) * sounding.sonar.range_resolution_m
    assert away == pytest.approx(sounding.view.range_m[board], abs=0.011)


def test_levels_outside_the_ping_are_nan(sounding: PingProducts) -> None:
    level = lookup_pixels(sounding.level, sounding.view, sounding.sonar)
    assert np.array_equal(np.isnan(level), ~pixel_cells(sounding.view, sounding.sonar)[2])


def test_the_louder_material_has_the_higher_snr(sounding: PingProducts) -> None:
    found = lookup_pixels(sounding.snr_db, sounding.view, sounding.sonar)
    wall, board = (np.nanmedian(found[sounding.view.surface == s]) for s in (WALL, BOARD))
    assert board - wall > 15.0


def test_the_snr_is_that_of_the_sonar_equation(sounding: PingProducts) -> None:
    """A wall of mud, Lambert's, seen on the axis: the patch of one beam and all elevations."""
    sonar, water = sounding.sonar, sounding.scene.water
    loss_db = 40.0 * np.log10(5.0) + 10.0 * water.absorption_db_per_m(sonar.frequency_hz)
    row = int(5.0 / sonar.range_resolution_m)
    near = sounding.snr_db[row - 1 : row + 6, sonar.beams // 2 - 3 : sonar.beams // 2 + 3]
    power = np.nansum(10.0 ** (near / 10.0), axis=0).mean()
    target_db = 10.0 * np.log10(power) - (
        sonar.source_level_db - loss_db - noise_level_db(sonar, water)
    )
    up_m = np.linspace(-1.1, 1.1, 201)
    pattern = vertical_two_way_power(up_m / np.hypot(up_m, 5.0), sonar.vertical_width_rad)
    patch_m2 = 5.0 * 1.06 * sonar.beam_width_rad * 2.2 * pattern.mean()
    assert target_db == pytest.approx(-32.0 + 10.0 * np.log10(patch_m2), abs=1.0)


def test_the_driver_reads_the_ping_that_is_drawn(sounding: PingProducts) -> None:
    ping = decoded_ping(sounding)
    assert np.array_equal(ping.image, sounding.image)
    assert ping.ping_id == 7
    assert ping.max_range_m == pytest.approx(sounding.sonar.range_m)


def test_the_raw_scan_shows_starboard_right(sounding: PingProducts) -> None:
    level = np.zeros((sounding.sonar.rows, sounding.sonar.beams), dtype=np.float32)
    level[:, 100:] = 1.0
    scan = raw_scan(level, sounding.sonar, rows=200)
    assert scan.shape[0] == 200
    assert scan[:, : scan.shape[1] // 2].max() == 0.0
    assert scan[:, scan.shape[1] // 2 :].max() == 1.0
    everywhere = raw_scan(np.ones_like(level), sounding.sonar, rows=200)
    assert everywhere[0, 0] == everywhere[-1, 0] == 0.0
    assert everywhere[100, everywhere.shape[1] // 2] == 1.0


def test_the_points_are_those_of_the_surfaces(folder: Path, sounding: PingProducts) -> None:
    cloud: Any = trimesh.load(folder / "points.ply")
    assert len(cloud.vertices) == np.count_nonzero(sounding.view.hit)
    assert set(np.round(cloud.vertices[:, 0], 3).tolist()) == {3.0, 5.0}


def test_camera_info_is_of_the_camera(folder: Path, sounding: PingProducts) -> None:
    info = yaml.safe_load((folder / "camera_info.yaml").read_text())
    assert info["K"][0] == pytest.approx(sounding.view.camera.focal_px)
    assert (info["K"][2], info["K"][5]) == (47.5, 29.5)
    assert (info["width"], info["height"]) == (96, 60)


def test_only_what_is_asked_for_is_written(sounding: PingProducts, tmp_path: Path) -> None:
    files = write_products(tmp_path / "a", sounding, ["depth"])
    assert sorted(path.name for path in files) == ["camera.npz", "depth.png"]
    assert sorted(tmp_path.glob("a/*")) == sorted(files)


def test_a_product_that_does_not_exist_is_refused(sounding: PingProducts, tmp_path: Path) -> None:
    with pytest.raises(SonarSimError, match=r"\bx\b.*polar, depth"):
        write_products(tmp_path, sounding, ["x"])


def test_depth_is_in_millimetres() -> None:
    depth = np.array([[0.0, 1.2344, 100.0]], dtype=np.float32)
    assert depth_picture(depth).tolist() == [[0, 1234, 65535]]


def test_normals_are_red_right_green_down_blue_ahead() -> None:
    normals = np.array([[[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]], dtype=np.float32)
    assert normal_picture(normals).tolist() == [[[0, 128, 128], [128, 128, 255], [0, 0, 0]]]


def test_labels_have_colours_of_their_own() -> None:
    colours = label_picture(np.arange(-1, 12, dtype=np.int32)[None])[0]
    assert len({tuple(colour) for colour in colours.tolist()}) == 13


def test_nothing_and_the_sea_have_no_material(scene: Scene) -> None:
    labels = surface_labels(scene)
    assert labels.materials == ("mud", "rock")
    assert labels.material(np.array([-2, -1, 0, 1], dtype=np.int32)).tolist() == [-2, -1, 0, 1]


def test_an_empty_scene_has_products_too(sounding: PingProducts, tmp_path: Path) -> None:
    sounder = ProductRenderer(Scene(), sounding.sonar, sounding.view.camera)
    made = sounder.at(sounding.map_T_sonar)
    assert len(write_products(tmp_path, made)) == 15
    assert np.isnan(made.snr_db).all()
