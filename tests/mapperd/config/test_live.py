from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.config.aliases import RESTORE
from mapperd.config.catalog import parameters, value_of
from mapperd.config.layers import DEFAULT, Layered, load_files
from mapperd.config.live import Applied, ConfigStore, Refused, SettingChange
from mapperd.config.tree import Config
from mapperd.errors import ConfigError

THRESHOLD = "filtering.intensity_threshold"


def store_with(
    *names: str, take: Callable[[Config], None] = lambda _: None, layered: Layered | None = None
) -> ConfigStore:
    store = ConfigStore(layered or Layered())
    store.follow(names or Config.__struct_fields__, take)
    return store


def reasons_of(result: Applied | Refused) -> dict[str, str]:
    assert isinstance(result, Refused), result
    return dict(result.reasons)


def test_change_holds_is_reported_and_has_its_origin() -> None:
    reported: list[Config] = []
    store = store_with(take=reported.append)
    result = store.apply({THRESHOLD: 50, "processing.frame_skip": 2}, "command")
    changes = (SettingChange(THRESHOLD, 35.0, 50), SettingChange("processing.frame_skip", 1, 2))
    assert result == Applied("command", changes)
    assert store.current.filtering.intensity_threshold == 50
    assert reported == [store.current]
    assert store.origin_of(THRESHOLD) == "command"
    assert store.origin_of("octree.voxel_resolution") == DEFAULT


def test_nothing_new_is_applied_and_nobody_is_reported() -> None:
    reported: list[Config] = []
    store = store_with(take=reported.append)
    assert store.apply({THRESHOLD: 35, "octree.voxel_resolution": 0.05}, "x") == Applied("x", ())
    assert store.origin_of(THRESHOLD) == DEFAULT
    assert reported == []


def test_every_mistake_is_named_and_nothing_changes() -> None:
    store = store_with()
    before = store.current
    changes = {
        THRESHOLD: 50,
        "processing.frame_skip": 0,
        "filtering.intensity_treshold": 3,
        "octree.voxel_resolution": 0.1,
        "filtering": {},
        "mapping.detail": "2",
    }
    reasons = reasons_of(store.apply(changes, "command"))
    assert reasons.pop("filtering").startswith("there is no such setting")
    assert reasons == {
        "processing.frame_skip": "0 is not allowed; allowed: a whole number >= 1 and <= 1000 "
        "(pings)",
        "filtering.intensity_treshold": f"there is no such setting; did you mean {THRESHOLD}?",
        "octree.voxel_resolution": "cannot change while running; needs a restart",
        "mapping.detail": "'2' is not allowed; allowed: a number >= 0.25 and <= 8",
    }
    assert store.current is before


def test_rules_about_several_settings_hold_for_changes() -> None:
    store = store_with()
    assert reasons_of(store.apply({"mapping.free_threshold": 0.8}, "x")) == {
        "mapping": "free_threshold 0.8 is above occupied_threshold 0.7; allowed: at most that"
    }
    both = {"mapping.free_threshold": 0.8, "mapping.occupied_threshold": 0.9}
    assert isinstance(store.apply(both, "x"), Applied)
    robots = {"robot_detection.enabled": True, "robot_detection.min_threshold": 100}
    assert list(reasons_of(store.apply(robots, "x"))) == ["settings"]


def test_setting_that_nobody_follows_is_not_taken_and_forgotten() -> None:
    store = store_with("filtering", "mounting.orientation.pitch")
    assert isinstance(store.apply({THRESHOLD: 1, "mounting.orientation.pitch": 3}, "x"), Applied)
    for name in ("mapping.threads", "mounting.orientation.roll"):
        assert "nothing that runs follows" in reasons_of(store.apply({name: 2}, "x"))[name]


def test_name_of_a_follower_is_no_prefix_of_words() -> None:
    store = store_with("filter", "filtering.min")
    assert isinstance(store.apply({THRESHOLD: 1}, "x"), Refused)


def test_refusal_of_one_undoes_it_for_all() -> None:
    seen: list[tuple[str, float]] = []

    def follower(name: str, limit: float) -> Callable[[Config], None]:
        def take(config: Config) -> None:
            value = config.filtering.intensity_threshold
            seen.append((name, value))
            if value > limit:
                raise ConfigError(f"{name} cannot", f"$.{THRESHOLD}")

        return take

    store = ConfigStore(Layered())
    for name, limit in (("a", 255), ("b", 100), ("c", 255)):
        store.follow(["filtering"], follower(name, limit))
    assert reasons_of(store.apply({THRESHOLD: 200}, "x")) == {THRESHOLD: "b cannot"}
    assert seen == [("a", 200), ("b", 200), ("b", 35), ("a", 35)]
    assert store.current == Config()
    assert store.origin_of(THRESHOLD) == DEFAULT


def test_who_is_asked_first_stops_it_before_anyone_is_reported() -> None:
    reported: list[Config] = []

    def never(_: Config) -> None:
        raise ConfigError("OpenCV is missing", "$.crosstalk.enabled")

    store = store_with(take=reported.append)
    store.follow(["crosstalk"], reported.append, check=never)
    result = store.apply({"crosstalk.enabled": True}, "x")
    assert reasons_of(result) == {"crosstalk.enabled": "OpenCV is missing"}
    assert reported == []


def test_fault_of_a_follower_undoes_the_change_and_is_not_hidden() -> None:
    def fails(config: Config) -> None:
        if config.filtering.intensity_threshold > 100:
            raise RuntimeError

    store = store_with(take=fails)
    with pytest.raises(RuntimeError):
        store.apply({THRESHOLD: 200}, "x")
    assert store.current == Config()
    assert isinstance(store.apply({THRESHOLD: 90}, "x"), Applied)


def layered_of(tmp_path: Path, text: str) -> Layered:
    path = tmp_path / "a.yaml"
    path.write_text(text, encoding="utf-8")
    return load_files([path])


def test_files_read_again_hold_and_what_needs_a_restart_is_reported(tmp_path: Path) -> None:
    text = "filtering: {intensity_threshold: 60}"
    store = store_with(layered=layered_of(tmp_path, text))
    store.apply({"processing.frame_skip": 5, THRESHOLD: 70}, "command")
    text = "filtering: {intensity_threshold: 80}\noctree: {voxel_resolution: 0.2}"
    reloaded = store.reload(layered_of(tmp_path, text), "SIGHUP")
    assert reloaded.waiting == ("octree.voxel_resolution",)
    assert isinstance(reloaded.result, Applied)
    assert [change.name for change in reloaded.result.changes] == [
        THRESHOLD,
        "processing.frame_skip",
    ]
    assert store.current.filtering.intensity_threshold == 80
    assert store.current.processing.frame_skip == 1
    assert store.current.octree.voxel_resolution == 0.05
    assert store.origin_of(THRESHOLD) == str(tmp_path / "a.yaml")
    assert store.origin_of("processing.frame_skip") == DEFAULT


def test_refused_reload_changes_nothing(tmp_path: Path) -> None:
    def never(_: Config) -> None:
        raise ConfigError("no", "$.filtering")

    store = ConfigStore(Layered())
    store.follow(["filtering"], lambda _: None, check=never)
    text = "filtering: {intensity_threshold: 80}\nprocessing: {frame_skip: 2}"
    reloaded = store.reload(layered_of(tmp_path, text), "SIGHUP")
    assert reasons_of(reloaded.result) == {"filtering": "no"}
    assert reloaded.waiting == ("processing.frame_skip",)
    assert store.current == Config()
    assert store.origin_of(THRESHOLD) == DEFAULT


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just([])
)


@given(st.dictionaries(st.sampled_from(sorted(parameters())), VALUES, max_size=4))
def test_any_values_are_applied_or_refused_with_reasons(changes: dict[str, object]) -> None:
    store = store_with()
    before = store.current
    result = store.apply(changes, "anyone")
    if isinstance(result, Refused):
        assert result.reasons
        assert store.current is before
    else:
        asked = {name: value for name, value in changes.items() if name != RESTORE}
        assert all(value_of(store.current, name) == value for name, value in asked.items())
        assert value_of(store.current, RESTORE) is False
    assert msgspec.convert(msgspec.to_builtins(store.current), Config) == store.current


def test_what_the_maps_file_knows_holds_until_the_files_report_otherwise(tmp_path: Path) -> None:
    store = store_with()
    zero = {"latitude": 54.0, "longitude": 10.5}
    config = store.settle("odometry.origin", zero, "the map's file")
    assert store.current is config
    assert config.odometry.origin is not None
    assert (config.odometry.origin.latitude, config.odometry.origin.longitude) == (54.0, 10.5)
    assert store.origin_of("odometry.origin") == "the map's file"
    assert store.reload(layered_of(tmp_path, "{}"), "SIGHUP").waiting == ()
    other = layered_of(tmp_path, "odometry: {origin: {latitude: 1, longitude: 2}}")
    assert store.reload(other, "SIGHUP").waiting == ("odometry.origin",)
    assert store.current.odometry.origin == config.odometry.origin
