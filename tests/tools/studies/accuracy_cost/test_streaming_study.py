"""The study of the map stream: its judge agrees with brute force, its link with arithmetic."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from studies.accuracy_cost.streaming import STUDY, dives
from studies.accuracy_cost.streaming.clients import (
    PlainClient,
    PlainSender,
    StreamClient,
    StreamSender,
)
from studies.accuracy_cost.streaming.dives import PLANS, LinkRate, SimulatedLink
from studies.accuracy_cost.streaming.knobs import constants, stream_setting
from studies.accuracy_cost.streaming.measuring import MapDeviation, moment, summary
from studies.accuracy_cost.streaming.truth import Ages, Blocks, coded, distances_m
from studies.accuracy_cost.study import Setting, StudyDive

from mapperd.config.tree import Config, OctreeConfig
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server import priority_queue
from mapperd.server.pacer import Pacer
from mapperd.wire import blocks
from mapperd.wire.messages import Interest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

SETTINGS = [*(setting for knob in STUDY.knobs for setting in knob.settings), *STUDY.wholes]
HERE = np.zeros(3)
VOXEL_M = 0.5


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting.key or "default")
def test_every_setting_is_one_and_turns_something(setting: Setting) -> None:
    assert (stream_setting(setting.overrides, 0.2) == stream_setting({}, 0.2)) == (
        not setting.overrides
    )


def test_a_default_is_labelled_as_what_the_daemon_has() -> None:
    labels = {
        name: default.label
        for knob in STUDY.knobs
        for default in knob.settings
        if not default.overrides
        for name in {name for setting in knob.settings for name in setting.overrides}
    }
    stream = Config().stream
    for field in ("log_odds_step", "rate", "bytes_per_s"):
        assert labels[f"stream.{field}"] == str(getattr(stream, field))
    assert labels["client.detail"] == Interest().detail
    assert labels["client.radius_m"] == str(Interest().radius_m)
    assert labels["client.level"] == str(2 ** Interest().level)
    assert labels["study.near_m"] == str(priority_queue.NEAR_M)
    assert labels["study.compression"] == str(blocks.LEVEL)


def test_a_setting_that_does_not_exist_is_refused() -> None:
    for name in ("stream.log_odds_steps", "client.levels", "study.near"):
        with pytest.raises(Exception, match=name.split(".")[1]):
            stream_setting({name: 1}, 0.2)


def test_what_is_no_setting_is_turned_for_a_while() -> None:
    before = priority_queue.NEAR_M, blocks.LEVEL
    with constants(replace(stream_setting({}, 0.2), near_m=3.0, compression=1)):
        assert (priority_queue.NEAR_M, blocks.LEVEL) == (3.0, 1)
    assert before == (priority_queue.NEAR_M, blocks.LEVEL)


def test_messages_take_their_turn_on_the_link_and_are_acknowledged() -> None:
    pacer = Pacer()
    link = SimulatedLink(LinkRate(rate=1000.0, delay_s=0.5), pacer)
    for message in (b"a" * 1000, b"b" * 500):
        pacer.note_sent(len(message), 0.0)
        link.carry(message)
    assert link.step(0.0) == []
    assert link.step(1.49) == []
    assert link.step(1.51) == [b"a" * 1000]
    assert pacer.acked == 0
    assert link.step(2.01) == [b"b" * 500]
    assert pacer.acked == 1000
    link.step(2.51)
    assert pacer.in_flight == 0


def test_no_more_is_in_flight_than_the_wire_holds_twice() -> None:
    pacer = Pacer()
    link = SimulatedLink(LinkRate(rate=10_000.0, delay_s=0.25), pacer)
    for _ in range(30):
        pacer.note_sent(1000, 0.0)
        link.carry(bytes(1000))
    link.step(0.0)
    assert link.unsent == 30_000 - 11_000


def random_map() -> SonarMap:
    """Blocks on both sides of zero, with voxels that are not known."""
    sonar_map = SonarMap(Config(octree=OctreeConfig(voxel_resolution=VOXEL_M)))
    dice = np.random.default_rng(4)
    points = dice.uniform(-12.0, 12.0, (4000, 3))
    sonar_map.core.set_log_odds(points, dice.normal(0.0, 3.0, len(points)))
    return sonar_map


def blocks_of(sonar_map: SonarMap) -> Blocks:
    return Blocks(*sonar_map.core.blocks())


def receive_all(sonar_map: SonarMap, interest: Interest, step: float) -> StreamClient:
    sender = StreamSender(sonar_map, interest, step, 0)
    client = StreamClient(sender.info(), interest)
    sender.look(0.0, HERE)
    while messages := sender.messages(1e3, HERE):
        for message, _ in messages:
            client.take(message)
        sender.pacer.note_ack(sender.pacer.sent, 1e3)
    return client


def dense(held: Blocks, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """x, y, z of a cube about the origin, -40 to 40 voxels; NaN where there is no block."""
    cube = np.full((96, 96, 96), np.nan)
    for key, block in zip(held.keys, values, strict=True):
        x, y, z = key * 16 + 48
        cube[x : x + 16, y : y + 16, z : z + 16] = block.reshape(16, 16, 16).transpose(2, 1, 0)
    return cube


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_a_client_that_was_reported_all_has_the_highest_of_each_cell(level: int) -> None:
    sonar_map = random_map()
    held, size = blocks_of(sonar_map), 2**level
    client = receive_all(sonar_map, Interest(level=level), 0.01)
    log_odds = np.where(held.counts > 0, held.units * 2.0**-24, -np.inf)
    reported = np.clip(np.round(log_odds, 2), -1.27, 1.27)
    cube = dense(held, np.where(np.isinf(log_odds), -np.inf, reported))
    cells = cube.reshape(96 // size, size, 96 // size, size, 96 // size, size)
    top = np.where(np.isnan(cells), -np.inf, cells).max(axis=(1, 3, 5))
    whole = top.repeat(size, 0).repeat(size, 1).repeat(size, 2)
    wanted = np.where(np.isinf(whole), np.nan, 1 / (1 + np.exp(-np.clip(whole, -9, 9))))
    found = dense(held, client.probabilities(held.keys).astype(np.float64))
    inside = ~np.isnan(cube)
    assert inside.sum() > 10_000
    # Thresholds move a sent step by at most one.
    assert np.isnan(found[inside]).tolist() == np.isnan(wanted[inside]).tolist()
    assert np.nanmax(np.abs(found[inside] - wanted[inside])) < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("interest", [Interest(level=k) for k in range(4)], ids=str)
def test_what_an_interest_should_be_reported_is_what_it_is_reported(interest: Interest) -> None:
    """Else a block would never be as new as the judge has it."""
    sonar_map = random_map()
    held = blocks_of(sonar_map)
    client = receive_all(sonar_map, interest, 0.25)
    facts = StreamSender(sonar_map, interest, 0.25, 0).info()
    reported, size = coded(held, facts, interest), 2**interest.level
    whole = reported.repeat(size, 1).repeat(size, 2).repeat(size, 3).reshape(len(reported), -1)
    wanted = np.where(whole == -128, np.nan, 1 / (1 + np.exp(-0.25 * whole)))
    assert client.probabilities(held.keys) == pytest.approx(wanted, abs=1e-6, nan_ok=True)


def test_a_client_of_a_radius_is_reported_what_is_within() -> None:
    sonar_map = random_map()
    held = blocks_of(sonar_map)
    client = receive_all(sonar_map, Interest(radius_m=6.0), 0.25)
    known = ~np.isnan(client.probabilities(held.keys))
    assert 0 < known.sum() < (held.counts > 0).sum()
    away_m = distances_m(held.keys.astype(np.int64), 16 * VOXEL_M, HERE)
    assert not known[away_m > 6.0].any()


def test_classes_are_a_step_beyond_their_thresholds() -> None:
    sonar_map = random_map()
    held = blocks_of(sonar_map)
    client = receive_all(sonar_map, Interest(detail="classes"), 0.25)
    found = client.probabilities(held.keys)[held.counts > 0]
    assert len(np.unique(found)) == 3
    mapping = sonar_map.config.mapping
    true = 1 / (1 + np.exp(-held.units[held.counts > 0] * 2.0**-24))
    assert ((found > mapping.occupied_threshold) == (true > mapping.occupied_threshold)).all()
    assert ((found < mapping.free_threshold) == (true < mapping.free_threshold)).all()


def test_plain_floats_are_exact() -> None:
    sonar_map = random_map()
    held = blocks_of(sonar_map)
    sender, client = PlainSender(sonar_map), PlainClient()
    sender.look(0.0, HERE)
    bytes_sent = 0
    while messages := sender.messages(1e3, HERE):
        for message, made_s in messages:
            assert made_s == 0.0
            client.take(message)
            bytes_sent += len(message)
        sender.pacer.note_ack(sender.pacer.sent, 1e3)
    known = held.counts > 0
    assert bytes_sent == pytest.approx(16 * known.sum(), rel=0.25)
    figures = moment(held, client, sender.info(), HERE)
    assert figures.p_error == pytest.approx(0.0, abs=1e-6)
    assert figures.known == known.sum()
    sender.look(1.0, HERE)
    assert sender.messages(2e3, HERE) == []


def test_nothing_known_is_as_wrong_as_not_knowing() -> None:
    sonar_map = random_map()
    held = blocks_of(sonar_map)
    sender = StreamSender(sonar_map, Interest(), 0.25, 0)
    client = StreamClient(sender.info(), Interest())
    figures = moment(held, client, sender.info(), HERE)
    true = 1 / (1 + np.exp(-held.units[held.counts > 0] * 2.0**-24))
    assert figures.p_error == pytest.approx(np.abs(true - 0.5).mean(), rel=1e-5)
    assert (figures.wrong_class_near, figures.known) == (1.0, 0)


def one_block(log_odds: float) -> Blocks:
    units = np.zeros((1, 4096), np.int32)
    counts = np.zeros((1, 4096), np.uint16)
    units[0, 0], counts[0, 0] = round(log_odds * 2**24), 1
    return Blocks(np.array([[1, 0, 0]], np.int32), units, counts)


def test_a_block_is_as_old_as_the_first_change_after_what_was_reported() -> None:
    facts = StreamSender(random_map(), Interest(), 0.25, 0).info()
    ages = Ages(facts, Interest())
    part = np.array([[2, 0, 0]], np.int32)
    for now_s, log_odds in ((1.0, 1.0), (2.0, 1.01), (3.0, 2.0)):
        ages.changed(one_block(log_odds), now_s)
    assert ages.oldest_s(4.0, HERE, 10.0) == (3.0, 0.0)
    ages.sent(part, 2.5)  # a hundredth was no step: as of then only that of 3 s is missing
    assert ages.oldest_s(4.0, HERE, 10.0) == (1.0, 0.0)
    assert ages.oldest_s(4.0, HERE, 7.9) == (0.0, 1.0)  # it begins 8 m away
    ages.sent(part, 3.0)
    assert ages.oldest_s(4.0, HERE, 10.0) == (0.0, 0.0)


def test_a_block_that_is_again_what_was_reported_is_not_old() -> None:
    """Changes that come and go between two looks are never sent."""
    facts = StreamSender(random_map(), Interest(), 0.25, 0).info()
    ages = Ages(facts, Interest())
    ages.changed(one_block(1.0), 1.0)
    ages.sent(np.array([[2, 0, 0]], np.int32), 1.0)
    ages.changed(one_block(2.0), 2.0)
    assert ages.oldest_s(4.0, HERE, 10.0) == (2.0, 0.0)
    ages.changed(one_block(1.0), 3.0)
    assert ages.oldest_s(4.0, HERE, 10.0) == (0.0, 0.0)


def test_ages_are_reported_by_their_quantiles_and_moments_by_their_mean() -> None:
    moments = [MapDeviation(0.1, 0.2, 0.3, 8.0, 2), MapDeviation(0.3, 0.2, 0.1, 0.0, 0)]
    figures = summary(moments, [(1.0, 5.0), (2.0, 6.0), (3.0, 7.0)])
    assert (figures["near_age_median_s"], figures["far_age_median_s"]) == (2.0, 6.0)
    assert figures["near_age_p95_s"] == pytest.approx(2.9)
    assert figures["p_error_near"] == pytest.approx(0.2)
    assert figures["log_odds_rms"] == 2.0


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[StudyDive, Path]]:
    """A few small pings."""
    dive, folder = StudyDive("short", 1), tmp_path_factory.mktemp("short")
    with pytest.MonkeyPatch.context() as patch:
        plan = replace(PLANS["short"], pings=18, joins=3, beams=32, rows=40)
        patch.setitem(PLANS, "short", plan)
        STUDY.prepare(dive, folder)
        yield dive, folder


@pytest.mark.slow
def test_a_dive_is_reported_alike_every_time(short: tuple[StudyDive, Path]) -> None:
    dive, folder = short
    kept = (folder / "pings.npz").stat().st_mtime_ns
    STUDY.prepare(dive, folder)
    assert (folder / "pings.npz").stat().st_mtime_ns == kept
    once, again = (STUDY.measure(Setting("", {}), dive, folder) for _ in range(2))
    assert set(once) == {column.name for column in STUDY.columns}
    times = [
        [reported.pop(name) for name in ("cpu_median_ms", "cpu_ms_per_ping", "cpu_p95_ms")]
        for reported in (once, again)
    ]
    assert all(min(reported) > 0 and max(reported) == reported[-1] for reported in times)
    assert once == again


def test_what_the_link_carries_decides_how_old_the_map_is(
    short: tuple[StudyDive, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    dive, folder = short
    thin = STUDY.measure(Setting("", {"stream.bytes_per_s": 2000}), dive, folder)
    assert thin["kb_per_s"] < 4.0
    wide = replace(dives.PLANS["short"], link=LinkRate(1e6, 0.01))
    monkeypatch.setitem(dives.PLANS, "short", wide)
    fast = STUDY.measure(Setting("", {}), dive, folder)
    assert fast["near_age_median_s"] < 0.5 * thin["near_age_median_s"]
    assert fast["p_error_near"] < 0.5 * thin["p_error_near"]
    coarse = STUDY.measure(Setting("", {"stream.log_odds_step": 2.0}), dive, folder)
    assert coarse["log_odds_rms"] > 1.3 * fast["log_odds_rms"]
    assert coarse["bytes_per_voxel"] < fast["bytes_per_voxel"]
