"""Maps by the arc rule: settings, classes, threads, files, and what is refused."""

import contextlib
import math
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd import _core
from mapperd.client.mirror import Cells, map_of
from mapperd.config.live import occupied_above, with_values
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError, MapError
from mapperd.export.cells import FREE, OCCUPIED, Heights, known_cells
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.known_map import load_known_map
from mapperd.localization.maps import keep_boundaries
from mapperd.mapping.arc import SurfaceLevel, SurfaceLevelState
from mapperd.mapping.core_args import arc_params, core_motion, rule_params
from mapperd.mapping.ping_log import ArcPing, PingLog
from mapperd.mapping.sonar_map import BLOCK_VOXELS, SonarMap
from mapperd.store.checkpoint import decode_state, encode_state
from mapperd.store.map_files import map_in
from mapperd.store.reader import StoreReader
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from mapperd.wire.messages import MapInfo
from oculus_driver.noise import noise_by_range

IWLO = with_values(Config(), {"octree.voxel_resolution": 0.1})
ARC = with_values(IWLO, {"mapping.rule": "arc"})


def image_of(number: int) -> PingImage:
    """Noise, and a wall 3 m away whose level changes from ping to ping."""
    random = np.random.default_rng([31, number])
    intensity = random.integers(0, 4, (200, 48)).astype(np.float32)
    intensity[150:160] = 20 + 4 * (number % 8)
    return PingImage(intensity, np.linspace(-0.6, 0.6, 48), 0.02)


def pose_of(number: int) -> np.ndarray:
    pitch = 0.1 * math.sin(number)
    pose = np.eye(4)
    pose[0, 0] = pose[2, 2] = math.cos(pitch)
    pose[0, 2], pose[2, 0] = math.sin(pitch), -math.sin(pitch)
    pose[:3, 3] = 0.05 * number, 0.02 * number, 0.0
    return pose


MOTION = PingMotion(np.array([0.5, 0.1, 0.0]), np.array([0.0, 0.1, 0.3]), 0.002, 1500.0)


def mapped(config: Config, pings: int = 12) -> SonarMap:
    sonar_map = SonarMap(config)
    for number in range(pings):
        sonar_map.integrate(image_of(number), pose_of(number), MOTION)
    return sonar_map


@pytest.fixture(scope="module")
def arc_map() -> SonarMap:
    return mapped(ARC)


def fixed(sonar_map: SonarMap) -> float:
    """Level that the map took for its last ping."""
    return float(sonar_map.rule_facts()["surface_level"])


def test_threads_do_not_change_the_map(arc_map: SonarMap) -> None:
    threaded = mapped(with_values(ARC, {"mapping.threads": 4}))
    assert threaded.sha256() == arc_map.sha256()
    assert arc_map.counts().occupied > 20


def test_settings_reach_the_rule() -> None:
    for name, value in (
        ("mapping.within_ping_motion", False),
        ("mapping.carve_no_return", True),
        ("filtering.min_range", 3.2),
        ("arc.level", 90.0),
        ("arc.prior", 0.1),
        ("arc.beam_width", 12.0),
        ("arc.lowest", -4.0),
        ("arc.highest", 0.0),
        ("arc.max_ratio", 1.0),
        ("arc.spread_below", 1.0),
        ("arc.spread_above", 3.0),
        ("arc.broad_share", 0.9),
        ("arc.missed_share", 0.3),
    ):
        one, other = (SonarMap(each) for each in (ARC, with_values(ARC, {name: value})))
        for sonar_map in (one, other):
            for number in range(6):
                image = image_of(number)
                if name == "mapping.carve_no_return":
                    image.intensity[150:160, :24] = 1.0
                sonar_map.integrate(image, pose_of(number), MOTION)
        assert one.sha256() != other.sha256(), name


def refined(config: Config, folder: Path, pings: int = 12) -> SonarMap:
    sonar_map = SonarMap(config)
    sonar_map.keep_pings(folder)
    for number in range(pings):
        if number == 7:
            sonar_map.start_session()
        motion = MOTION if number % 2 else None
        sonar_map.integrate(image_of(number), pose_of(number), motion)
    assert sonar_map.kept_pings == pings
    assert list(sonar_map.refine()) == list(range(1, pings + 1))
    assert sonar_map.kept_pings == 0
    return sonar_map


def test_refining_takes_the_pings_again_from_the_last(tmp_path: Path) -> None:
    sonar_map = refined(ARC, tmp_path)
    wanted, kept = SonarMap(ARC), []
    for number in range(12):
        if number == 7:
            wanted.start_session()
        image, pose = image_of(number), pose_of(number)
        motion = MOTION if number % 2 else None
        wanted.skip(image)
        level = wanted.surface.by_beam(48) if wanted.surface is not None else np.ones(48)
        noise = np.maximum(1.0, 0.35 * noise_by_range(image.intensity)).astype(np.float32)
        arguments: tuple[Any, ...] = (
            _core.ArcModel(arc_params(ARC), rule_params(ARC)),
            image.intensity / level,
            noise / level.mean(),
            image.bearings_rad,
            image.range_resolution_m,
            pose,
        )
        options: dict[str, Any] = {
            "motion": core_motion(motion),
            "min_range_m": ARC.filtering.min_range,
        }
        changes = _core.ArcChanges()
        wanted.core.integrate_arc(*arguments, **options, changes=changes)
        kept.append((arguments, changes, options))
    before = wanted.sha256()
    for arguments, changes, options in reversed(kept):
        wanted.core.refine_arc(*arguments, **options, changes=changes)
    assert sonar_map.sha256() == wanted.sha256() != before


def test_kept_pings_come_back_exactly(tmp_path: Path) -> None:
    model, log = _core.ArcModel(arc_params(ARC), rule_params(ARC)), PingLog(tmp_path)
    pings = []
    for number, factor in ((1, 1.0), (2, 0.37), (3, 100.0)):  # whole levels, parts, above 255
        image = image_of(number)
        motion = MOTION if number == 2 else None
        level, noise = np.full(48, 20.5, np.float32), np.full(200, 1.5, np.float32)
        intensity = (factor * image.intensity).astype(np.float32)
        pose = pose_of(number)
        ping = ArcPing(
            intensity, level, noise, image.bearings_rad, 0.02, pose, motion, 0.5, number == 1, model
        )
        changes = _core.ArcChanges(
            np.array([number, 0], dtype=np.uint32), np.arange(number, dtype=np.int16) - 2
        )
        pings.append((ping, changes))
        log.add(ping, changes)
    assert list(tmp_path.iterdir()) == []
    with contextlib.closing(log):
        found = list(log.from_last())
    for (ping, changes), (same, changes_too) in zip(reversed(pings), found, strict=True):
        one: Any
        other: Any
        for one, other in zip(ping, same, strict=True):
            if isinstance(one, PingMotion):
                for a, b in zip(astuple(one), astuple(other), strict=True):
                    assert np.array_equal(a, b)
            elif isinstance(one, np.ndarray):
                assert other.dtype == one.dtype
                assert np.array_equal(other, one)
            else:
                assert other == one
        assert changes_too.counts.tolist() == changes.counts.tolist()
        assert changes_too.steps.tolist() == changes.steps.tolist()


def test_refined_map_does_not_depend_on_threads(tmp_path: Path) -> None:
    threaded = refined(with_values(ARC, {"mapping.threads": 3}), tmp_path)
    assert threaded.sha256() == refined(ARC, tmp_path).sha256()


def test_pings_before_the_map_was_emptied_are_not_refined(tmp_path: Path) -> None:
    sonar_map, wanted = SonarMap(ARC), SonarMap(ARC)
    sonar_map.keep_pings(tmp_path)
    sonar_map.integrate(image_of(1), pose_of(1))
    wanted.skip(image_of(1))
    sonar_map.clear()
    wanted.keep_pings(tmp_path)
    for each in (sonar_map, wanted):
        for number in (2, 3):
            each.integrate(image_of(number), pose_of(number))
        assert list(each.refine()) == [1, 2]
    assert sonar_map.sha256() == wanted.sha256()


def test_only_maps_of_the_arc_rule_can_be_refined(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rule arc"):
        SonarMap(IWLO).keep_pings(tmp_path)
    assert list(SonarMap(IWLO).refine()) == []
    abandoned = SonarMap(ARC)
    abandoned.keep_pings(tmp_path)
    abandoned.close()
    with pytest.raises(ExportError, match=r"no-folder.*refining"):
        SonarMap(ARC).keep_pings(tmp_path / "no-folder")


def test_settings_of_iwlo_have_no_effect(arc_map: SonarMap) -> None:
    changes = {"iwlo.L_occ": 1.0, "adaptive.max_ratio": 1.0, "sonar.vertical_aperture": 40.0}
    assert mapped(with_values(ARC, changes)).sha256() == arc_map.sha256()


def test_iwlo_does_not_depend_on_the_section_of_the_arc_rule() -> None:
    bright = with_values(IWLO, {"filtering.intensity_threshold": 10.0})
    other = with_values(bright, {"arc.prior": 0.2, "arc.occupied_threshold": 0.9})
    maps = mapped(bright), mapped(other)
    assert maps[0].sha256() == maps[1].sha256()
    assert maps[0].counts() == maps[1].counts()
    assert maps[0].counts().occupied > 20


def test_level_rests_on_the_pings_of_the_session(arc_map: SonarMap) -> None:
    facts = arc_map.rule_facts()
    assert facts["rule"] == "arc"
    assert facts["surface_returns"] > 50
    again = mapped(ARC)
    again.start_session()
    assert again.rule_facts()["surface_returns"] == 0
    assert again.sha256() == arc_map.sha256()  # the voxels stay
    set_to = mapped(with_values(ARC, {"arc.level": 33.0}))
    assert set_to.rule_facts() == {
        "rule": "arc",
        "surface_level": 33.0,
        "surface_returns": None,
    }
    assert SonarMap(IWLO).rule_facts() == {"rule": "iwlo"}


def first_returns(left: float, right: float) -> PingImage:
    """A wall of two levels, and nothing else."""
    intensity = np.zeros((200, 128), dtype=np.float32)
    intensity[150:160, :64], intensity[150:160, 64:] = left, right
    return PingImage(intensity, np.linspace(-0.6, 0.6, 128), 0.02)


SILENCE = np.ones(200, dtype=np.float32)


def test_level_follows_bearing_and_the_last_pings() -> None:
    surface = SurfaceLevel(0.1)
    assert surface.by_beam(4).tolist() == [SurfaceLevel.DEFAULT] * 4
    for _ in range(40):
        surface.add(first_returns(20.0, 20.0), SILENCE)
    assert surface.level == pytest.approx(26.0)
    assert surface.by_beam(128) == pytest.approx(26.0)
    for _ in range(SurfaceLevel.PINGS):
        surface.add(first_returns(10.0, 20.0), SILENCE)
    levels = surface.by_beam(128)
    assert surface.level == pytest.approx(26.0)
    assert levels[:50].min() > 13.0
    assert levels[:50].max() < 20.0
    assert levels[90:] == pytest.approx(26.0)
    for _ in range(SurfaceLevel.PINGS):
        surface.add(first_returns(20.0, 20.0), SILENCE)
    assert surface.by_beam(128) == pytest.approx(26.0)


def test_returns_that_face_the_sonar_do_not_count() -> None:
    surface = SurfaceLevel(0.1)
    surface.add(first_returns(20.0, 200.0), SILENCE)
    assert surface.returns == 16
    assert surface.level == pytest.approx(26.0)


def test_echoes_below_the_noise_are_no_returns() -> None:
    surface = SurfaceLevel(0.1)
    noise = SILENCE.copy()
    noise[100:] = 5.0
    surface.add(first_returns(20.0, 30.0), noise)
    assert surface.returns == 16
    assert surface.level == pytest.approx(39.0)


def test_level_continues_from_its_state() -> None:
    whole, part = SurfaceLevel(0.1), SurfaceLevel(0.1)
    for number in range(20):
        if number == 11:
            rest, part = part, SurfaceLevel(0.1)
            part.restore(decode_state(encode_state(rest.state()), SurfaceLevelState))
        for surface in (whole, part):
            surface.add(first_returns(10.0 + number, 30.0 - number), SILENCE)
        assert part.by_beam(128).tolist() == whole.by_beam(128).tolist()
    counts, recent = whole.state()
    for wrong in (
        SurfaceLevelState(counts[:-1], recent),
        SurfaceLevelState(counts, recent[:, :2]),
        SurfaceLevelState(counts, recent.astype(np.int64)),
        SurfaceLevelState(counts, np.full((1, 3), 200, dtype=np.uint8)),
    ):
        with pytest.raises(ValueError, match=r"first returns|histogram"):
            whole.restore(wrong)


def test_a_refused_ping_counts_as_one_that_is_skipped() -> None:
    small = with_values(ARC, {"mapping.max_swath_voxels": 1000})
    refusing, skipping = SonarMap(small), SonarMap(small)
    with pytest.raises(MapError, match="max_swath_voxels"):
        refusing.integrate(image_of(0), pose_of(0))
    skipping.skip(image_of(0))
    assert refusing.rule_facts() == skipping.rule_facts()
    assert refusing.rule_facts()["surface_returns"] > 0
    assert refusing.core.revision == 0


def test_swath_is_that_of_the_arcs() -> None:
    """Its height is that of the heard aperture, not of `sonar.vertical_aperture`."""
    image = image_of(0)
    half = math.sin(math.radians(15.0))
    voxels = 2 * half * 1.2 * (image.max_range_m / 0.1) ** 3 / 3
    for most, is_refused in ((0.98 * voxels, True), (1.02 * voxels, False)):
        sonar_map = SonarMap(with_values(ARC, {"mapping.max_swath_voxels": int(most)}))
        if is_refused:
            with pytest.raises(MapError):
                sonar_map.integrate(image, pose_of(0))
        else:
            sonar_map.integrate(image, pose_of(0))


def test_changes_lie_in_the_announced_box() -> None:
    for number in range(4):
        sonar_map = SonarMap(ARC)
        box = sonar_map.blocks_of(image_of(number), pose_of(number), MOTION)
        assert box is not None
        sonar_map.integrate(image_of(number), pose_of(number), MOTION)
        keys, _, counts = sonar_map.core.blocks()
        changed = keys[(counts > 0).any(axis=1)]
        assert (changed >= box[0]).all()
        assert (changed <= box[1]).all()
        height_m = (changed[:, 2].max() - changed[:, 2].min() + 1) * BLOCK_VOXELS * 0.1
        assert height_m >= 3.0 * 2 * math.sin(math.radians(15.0))


def test_constants_of_the_rule_cannot_change_in_a_map() -> None:
    sonar_map = mapped(ARC, 2)
    before = sonar_map.config
    for name, value in (
        ("mapping.rule", "iwlo"),
        ("arc.prior", 0.1),
        ("arc.lowest", -5.0),
        ("arc.max_ratio", 0.5),
        ("arc.broad_share", 0.2),
        ("octree.voxel_resolution", 0.2),
    ):
        with pytest.raises(ConfigError, match="cannot change"):
            sonar_map.reconfigure(with_values(ARC, {name: value}))
        assert sonar_map.config is before
    with pytest.raises(ConfigError, match=r"mapping\.rule"):
        SonarMap(IWLO).reconfigure(ARC)
    SonarMap(IWLO).reconfigure(with_values(IWLO, {"arc.prior": 0.1}))


def test_level_and_thresholds_may_change_in_a_map(arc_map: SonarMap) -> None:
    sonar_map = mapped(ARC)
    none = {"arc.occupied_threshold": 0.9999, "arc.free_threshold": 0.0001}
    sonar_map.reconfigure(with_values(ARC, none | {"arc.level": 50.0, "arc.beam_width": 12.0}))
    assert (sonar_map.counts().occupied, sonar_map.counts().free) == (0, 0)
    assert fixed(sonar_map) == 50.0
    sonar_map.reconfigure(ARC)
    assert sonar_map.counts() == arc_map.counts()


PLATE, WATER, UNCERTAIN = -1.0, -5.0, -2.0
"""Classes by the thresholds of the arc rule; by those of IWLO all are free."""


def layers() -> SonarMap:
    """An occupied plate of 8 x 8 voxels, water over it, and a layer of uncertain voxels."""
    sonar_map = SonarMap(ARC)
    x, y = np.mgrid[0:8, 0:8].reshape(2, -1) * 0.1 + 0.05
    for z, value in ((0.05, PLATE), (0.15, WATER), (0.25, UNCERTAIN)):
        points = np.stack([x, y, np.full(x.shape, z)], axis=1)
        sonar_map.core.set_log_odds(points, np.full(len(points), value))
    return sonar_map


def test_every_reader_takes_the_thresholds_of_the_rule(tmp_path: Path) -> None:
    sonar_map = layers()
    counts = sonar_map.counts()
    assert (counts.occupied, counts.free, counts.uncertain) == (64, 64, 64)
    assert sum(len(some) for some in sonar_map.voxel_batches("occupied")) == 64
    assert sum(len(some) for some in sonar_map.voxel_batches("free")) == 64
    for heights, kind in ((Heights(0.0, 0.1), OCCUPIED), (Heights(0.1, 0.2), FREE)):
        grid = known_cells(sonar_map, heights)
        assert grid is not None
        assert (grid.values == kind).all()
    assert known_cells(sonar_map, Heights(0.2, 0.3)) is None
    assert keep_boundaries(layers()) == 64
    known = tmp_path / "plate.map"
    sonar_map.save(known)
    bands = {"localization.geometry": "2d", "localization.band_low": 0.0}
    config = with_values(ARC, bands | {"localization.band_high": 0.2})
    assert (load_known_map(known, config).grid.occupancy == 100).sum() == 64


def test_a_clients_copy_is_of_the_rule_of_the_daemons_map() -> None:
    centres_m = np.array([[0.05, 0.05, 0.05], [0.15, 0.05, 0.05], [0.25, 0.05, 0.05]])
    log_odds = np.array([PLATE, -5.0, 14.0], dtype=np.float32)
    some = np.ones(3, dtype=np.uint16)
    cells = Cells(centres_m, log_odds, log_odds, some, some.astype(np.int64))
    limits = (math.log(0.12 / 0.88), math.log(0.03 / 0.97))
    facts = MapInfo("id", 0.1, 0.1, *limits, prior_log_odds=ARC.arc.prior_log_odds)
    copy = map_of(cells, 0.1, facts, Config())
    assert copy.config.mapping.rule == "arc"
    assert copy.config.arc.prior == pytest.approx(0.05)
    assert (copy.counts().occupied, copy.counts().free) == (2, 1)
    assert copy.core.query(centres_m)[0] == pytest.approx(log_odds, abs=1e-3)
    by_iwlo = MapInfo("id", 0.1, 0.1, *limits)
    assert map_of(cells, 0.1, by_iwlo, ARC).config.mapping.rule == "iwlo"


def test_min_probability_is_that_of_either_rule() -> None:
    for config in (IWLO, ARC):
        changed = with_values(config, occupied_above(config, 0.01))
        assert changed.occupied_threshold == 0.01
        assert changed.free_threshold == min(config.free_threshold, 0.01)


def test_thresholds_must_be_in_order() -> None:
    with pytest.raises(ConfigError, match="free_threshold"):
        with_values(ARC, {"arc.free_threshold": 0.5})
    with pytest.raises(ConfigError, match="lowest"):
        with_values(ARC, {"arc.lowest": -1.0})


def test_map_files_state_rule_and_prior(arc_map: SonarMap, tmp_path: Path) -> None:
    path = tmp_path / "arc.map"
    config = with_values(ARC, {"arc.prior": 0.0123456789, "arc.lowest": -5.5})
    for settings in (ARC, config):
        saved = mapped(settings, 4)
        saved.save(path)
        found = map_in(path, Config()).map  # the file tells the rule
        assert found.config.mapping.rule == "arc"
        assert found.config.arc.prior == pytest.approx(settings.arc.prior, abs=1e-7)
        assert found.config.arc.lowest == settings.arc.lowest
        assert found.sha256() == saved.sha256()
        assert found.counts() == saved.counts()
    again = SonarMap(ARC)
    arc_map.save(path)
    again.load(path)
    assert again.sha256() == arc_map.sha256()


def test_map_files_of_another_rule_or_prior_are_refused(arc_map: SonarMap, tmp_path: Path) -> None:
    arc, iwlo = tmp_path / "arc.map", tmp_path / "iwlo.map"
    arc_map.save(arc)
    mapped(IWLO, 2).save(iwlo)
    assert map_in(iwlo, ARC).map.config.mapping.rule == "iwlo"
    for config, path in (
        (IWLO, arc),
        (ARC, iwlo),
        (with_values(ARC, {"arc.prior": 0.1}), arc),
    ):
        refusing = SonarMap(config)
        with pytest.raises(MapError, match="different rules or priors"):
            refusing.load(path)
        assert refusing.core.block_count == 0


def test_trees_of_octomap_state_rule_and_prior(arc_map: SonarMap, tmp_path: Path) -> None:
    path = tmp_path / "arc.ot"
    arc_map.save_octomap(path)
    found = map_in(path, Config()).map
    assert found.config.mapping.rule == "arc"
    assert found.config.arc.prior == ARC.arc.prior
    assert found.counts() == arc_map.counts()
    with pytest.raises(MapError, match=r"another mapping\.rule"):
        SonarMap(IWLO).load_octomap(path.read_bytes())
    with pytest.raises(MapError, match=r"another mapping\.rule"):
        SonarMap(with_values(ARC, {"arc.prior": 0.1})).load_octomap(path.read_bytes())
    assert b"rule" not in mapped(IWLO, 1).octomap_ot()[:200]


def test_classes_in_a_tree_of_octomap_are_those_of_iwlo(arc_map: SonarMap, tmp_path: Path) -> None:
    path = tmp_path / "arc.bt"
    arc_map.save_octomap(path)
    found = map_in(path, ARC).map
    assert found.config.mapping.rule == "iwlo"
    ours, theirs = arc_map.counts(), found.counts()
    assert (theirs.occupied, theirs.free) == (ours.occupied, ours.free)
    assert (load_known_map(path, ARC).grid.occupancy == 100).any()


def test_file_of_the_daemon_states_the_rule(tmp_path: Path, arc_map: SonarMap) -> None:
    path = tmp_path / "dive.db"
    sonar_map = SonarMap(ARC)
    with TileStore(path, sonar_map, tile_size_m=3.2, cache_tiles=2) as store:
        for number in range(12):
            sonar_map.integrate(image_of(number), pose_of(number), MOTION)
            store.advance(bytes([number]))
    found = map_in(path, Config()).map
    assert isinstance(found, StoredMap)
    assert found.config.arc == ARC.arc
    assert found.counts() == arc_map.counts()
    assert found.sha256() == arc_map.sha256()
    copies = tmp_path / "stored.map", tmp_path / "memory.map"
    found.save(copies[0])
    arc_map.save(copies[1])
    assert copies[0].read_bytes() == copies[1].read_bytes()
    found.save_octomap(tmp_path / "stored.ot")
    assert (tmp_path / "stored.ot").read_bytes() == arc_map.octomap_ot()
    found.close()
    with StoreReader(path) as reader:
        assert reader.kind()["mapping.rule"] == "arc"


def test_each_beam_is_compared_with_its_own_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halves that return the same part of their levels make mirror images."""

    def halves(_: SurfaceLevel, beams: int) -> np.ndarray:
        return np.repeat(np.array([15.0, 30.0], dtype=np.float32), beams // 2)

    monkeypatch.setattr(SurfaceLevel, "by_beam", halves)
    sonar_map = SonarMap(ARC)
    for pitch in (-0.15, 0.0, 0.15):
        pose = np.eye(4)
        pose[0, 0] = pose[2, 2] = math.cos(pitch)
        pose[0, 2], pose[2, 0] = math.sin(pitch), -math.sin(pitch)
        sonar_map.integrate(first_returns(15.0, 30.0), pose)
    port, _, counts = sonar_map.core.voxels()
    log_odds, observed = sonar_map.core.query(port * (1, -1, 1))
    assert (counts > 0).sum() > 1000
    assert np.mean(np.abs(log_odds - sonar_map.core.query(port)[0]) < 1e-3) > 0.99
    assert observed.mean() > 0.99
