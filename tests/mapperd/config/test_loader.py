import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.config.loader import MAX_FILE_BYTES, config_from_text, load_config
from mapperd.config.tree import BacklogConfig, Config, MappingConfig
from mapperd.errors import ConfigError

BOMB = "a: &a [x, x]\n" + "\n".join(
    f"{name}: &{name} [*{before}, *{before}]"
    for before, name in zip("abcdefghijklmnop", "bcdefghijklmnopq", strict=True)
)


@pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n", "iwlo:\n", "{}"])
def test_nothing_means_the_defaults(text: str) -> None:
    assert config_from_text(text) == Config()


@pytest.mark.parametrize(
    ("text", "resolution"),
    [
        ("octree: {voxel_resolution: 0.2}", 0.2),
        ("octree: {voxel_resolution: 2}", 2.0),
        ("octree: {voxel_resolution: 2e-1}", 0.2),
        ("octree:\n  voxel_resolution: 1.0e-1\n", 0.1),
        ("octree: {voxel_resolution: +.5}", 0.5),
        ("octree: {voxel_resolution: 10.}", 10.0),
        ("\ufeffoctree: {voxel_resolution: 0.2}", 0.2),
    ],
)
def test_values_are_read(text: str, resolution: float, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, encoding="utf-8")
    assert load_config(path).octree.voxel_resolution == resolution


def test_floor_of_the_scale_is_read_and_bounded() -> None:
    assert config_from_text("adaptive: {min_ratio: 0}").adaptive.min_ratio == 0
    assert config_from_text("adaptive: {min_ratio: 0.1}").adaptive.min_ratio == 0.1
    with pytest.raises(ConfigError, match=r"\$\.adaptive: min_ratio 0\.25 .*max_ratio 0\.1"):
        config_from_text("adaptive: {max_ratio: 0.1}")


@pytest.mark.parametrize(
    ("text", "path", "words"),
    [
        ("octree: {voxel_resolution: -0.1}", "$.octree.voxel_resolution", ["-0.1", ">= 0.001"]),
        ("octree: {voxel_resolution: 0}", "$.octree.voxel_resolution", [">= 0.001"]),
        ("octree: {voxel_resolution: .nan}", "$.octree.voxel_resolution", [".nan", "<= 100"]),
        ("octree: {voxel_resolution: .inf}", "$.octree.voxel_resolution", [".inf"]),
        ("octree: {voxel_resolution: big}", "$.octree.voxel_resolution", ["big", "(m)"]),
        ("octree: {voxel_resolution: '0.1'}", "$.octree.voxel_resolution", ["'0.1'"]),
        ("octree: {voxel_resolution: [1]}", "$.octree.voxel_resolution", ["a number"]),
        ("octree: {voxel_resolution: }", "$.octree.voxel_resolution", ["nothing"]),
        ("octree: {voxel_resolution: true}", "$.octree.voxel_resolution", ["true"]),
        ("octree: {voxel_resolution: 2001-01-01}", "$.octree.voxel_resolution", ["2001"]),
        ("octree: {voxel_resolution: 1:30}", "$.octree.voxel_resolution", ["1:30"]),
        ("octree: {voxel_resolution: 1:30.5}", "$.octree.voxel_resolution", ["1:30.5"]),
        ("octree: {voxel_resolution: 1_0}", "$.octree.voxel_resolution", ["1_0"]),
        ("octree: {voxel_resolution: 1_0.5}", "$.octree.voxel_resolution", ["1_0.5"]),
        ("octree: {voxel_resolution: 0x10}", "$.octree.voxel_resolution", ["0x10"]),
        ("octree: {voxel_resolution: 0b11}", "$.octree.voxel_resolution", ["0b11"]),
        ("processing: {frame_skip: 010}", "$.processing.frame_skip", ["010"]),
        ("adaptive: {update: off}", "$.adaptive.update", ["off"]),
        ("adaptive: {update: Yes}", "$.adaptive.update", ["Yes"]),
        ("mounting: {position: {z: .nan}}", "$.mounting.position.z", [".nan"]),
        ("processing: {frame_skip: 1.5}", "$.processing.frame_skip", ["whole number"]),
        ("processing: {frame_skip: 0}", "$.processing.frame_skip", [">= 1"]),
        ("adaptive: {min_ratio: 1.5}", "$.adaptive.min_ratio", ["1.5", "<= 1"]),
        ("adaptive: {min_ratio: -0.1}", "$.adaptive.min_ratio", ["-0.1", ">= 0"]),
        ("adaptive: {update: 1}", "$.adaptive.update", ["true or false"]),
        ("mapping: {integrator: x}", "$.mapping.integrator", ["evidence_grid or rays"]),
        ("octree: {voxel_size: 1}", "$.octree.voxel_size", ["no such setting"]),
        ("octree: {voxel_resolutoin: 1}", "$.octree.voxel_resolutoin", ["mean voxel_resolution"]),
        ("octre: {}", "$.octre", ["did you mean octree"]),
        ("octree: 3", "$.octree", ["section"]),
        ("mounting: {position: [1, 2, 3]}", "$.mounting.position", ["x, y, z"]),
        ("iwlo: {decay_rate: 1e-6}", "$.iwlo", ["65535"]),
        ("odometry: {sources: []}", "$.odometry.sources", ["list of 1 to 16 sections of format"]),
        ("odometry: {sources: [{link: 3}]}", "$.odometry.sources[0].link", [": 3 is", "a link"]),
        ("odometry: {sources: [{nme: a}]}", "$.odometry.sources[0].nme", ["did you mean name"]),
        ("odometry: {sources: [{}, 3]}", "$.odometry.sources[1]", ["section", "latency_sec"]),
        ("odometry: {origin: 3}", "$.odometry.origin", ["nothing or a section of latitude"]),
        ("odometry: {origin: {latitude: 91}}", "$.odometry.origin.latitude", ["91", "<= 90"]),
        ("- a", "$", ["mapping"]),
        ("words", "$", ["mapping"]),
        ("1: 2", "$", ["key"]),
    ],
)
def test_mistakes_are_named_with_their_place(text: str, path: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        config_from_text(text, "my.yaml")
    message = str(caught.value)
    assert caught.value.path == path
    assert message.startswith(f"my.yaml: {path}: ")
    assert "\n" not in message
    assert all(word in message for word in words), message


def test_settings_of_an_earlier_version_load() -> None:
    config = config_from_text(
        "mapping: {integrator: projective, error_bound: 0.05, threads: 2}\n"
        "behind: {policy: coarser_first, error_bound: 0.5, max_wait: 2}\n"
    )
    assert config == Config(mapping=MappingConfig(threads=2), behind=BacklogConfig(max_wait=2.0))


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("mapping: {error_bund: 1}", "$.mapping.error_bund"),
        ("behind: [policy]", "$.behind"),
        ("mapping: {integrator: [projective]}", "$.mapping.integrator"),
        ("mapping: {integrator: projective, threads: 0}", "$.mapping.threads"),
    ],
)
def test_mistakes_beside_settings_of_an_earlier_version_are_named(text: str, path: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config_from_text(text)
    assert caught.value.path == path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("octree: {}\noctree: {}", "line 2, column 1: octree is set twice"),
        ("octree: {voxel_resolution: 1, voxel_resolution: 2}", "set twice"),
        ("octree: &x {}\niwlo: *x", "aliases"),
        (BOMB, "aliases"),
        ("[" * 100_000, "nested deeper"),
        ("{a: " * 5000, "nested deeper"),
        ("a: [", "not YAML"),
        ("\tx", "not YAML"),
        ("\x00", "not YAML"),
        ("a: 1\n---\nb: 2", "another document"),
        ("!!python/object/apply:os.system [ls]", "tags"),
        ("a: !!binary x", "tags"),
        ("<<: {a: 1}", "merge keys"),
        ("? [a]\n: 1", "a key must be a name"),
        (f"a: {'9' * 10_000}", "not YAML"),
    ],
)
def test_what_is_not_our_yaml_is_one_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config_from_text(text, "my.yaml")
    message = str(caught.value)
    assert message.startswith("my.yaml: ")
    assert words in message
    assert "\n" not in message
    assert len(message) < 200


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"octree: \xff\xfe")
    huge = tmp_path / "huge.yaml"
    huge.write_bytes(b"#" * (MAX_FILE_BYTES + 1))
    os.mkfifo(tmp_path / "pipe")
    cases = {
        tmp_path / "none.yaml": "No such file",
        tmp_path: "directory",
        tmp_path / "pipe": "no regular file",
        binary: "not UTF-8",
        huge: "not a settings file",
    }
    for path, words in cases.items():
        with pytest.raises(ConfigError, match=words) as caught:
            load_config(path)
        assert str(path) in str(caught.value)


@given(st.text(max_size=200))
def test_any_text_gives_settings_or_one_line(text: str) -> None:
    try:
        assert isinstance(config_from_text(text), Config)
    except ConfigError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017 the other way is fine too
