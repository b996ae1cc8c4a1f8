import os
import re
from pathlib import Path

import pytest

from mapperd.config.aliases import IGNORED
from mapperd.config.catalog import parameters
from mapperd.config.daemon import ServerConfig
from mapperd.config.layers import DEFAULT, load_files, load_settings, settings_files
from mapperd.config.tree import Config
from mapperd.errors import ConfigError


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_without_files_the_defaults_hold(tmp_path: Path) -> None:
    layered = load_settings([], {"HOME": str(tmp_path)}, tmp_path / "etc")
    assert layered.config == Config()
    assert layered.origin_of("octree.voxel_resolution") == DEFAULT


def test_files_lie_in_their_order(tmp_path: Path) -> None:
    etc, xdg = tmp_path / "etc", tmp_path / "xdg"
    files = [
        write(xdg / "mapperd" / "mapperd.yaml", ""),
        write(xdg / "mapperd" / "conf.d" / "a.yaml", ""),
        write(etc / "mapperd.yaml", ""),
        write(etc / "conf.d" / "10-a.yaml", ""),
        write(etc / "conf.d" / "20-b.yaml", ""),
        tmp_path / "variable.yaml",
        tmp_path / "first.yaml",
        tmp_path / "last.yaml",
    ]
    write(etc / "conf.d" / "30-c.yaml.bak", "no yaml: [")
    environ = {"XDG_CONFIG_HOME": str(xdg), "MAPPERD_CONFIG": str(files[5]), "HOME": "/nowhere"}
    assert settings_files(files[6:], environ, etc) == files


@pytest.mark.parametrize("base", ["", "relative"])
def test_user_s_folder_is_below_home_by_default(tmp_path: Path, base: str) -> None:
    path = write(tmp_path / ".config" / "mapperd" / "mapperd.yaml", "")
    environ = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": base}
    assert settings_files([], environ, tmp_path / "etc") == [path]


def test_no_home_is_no_folder(tmp_path: Path) -> None:
    assert settings_files([], {}, tmp_path) == []


def test_last_file_that_names_a_setting_reports_it(tmp_path: Path) -> None:
    low = write(tmp_path / "low.yaml", "mounting: {position: {x: 1, y: 2}}\niwlo:\n")
    high = write(tmp_path / "high.yaml", "mounting: {position: {y: 3}, orientation: {pitch: 30}}")
    layered = load_files([low, high])
    position = layered.config.mounting.position
    assert (position.x, position.y, position.z) == (1, 3, -0.5)
    assert layered.origin_of("mounting.position.x") == str(low)
    assert layered.origin_of("mounting.position.y") == str(high)
    assert layered.origin_of("mounting.position.z") == DEFAULT
    assert layered.origin_of("mounting.orientation.pitch") == str(high)


def test_settings_of_an_earlier_version_are_reported_in_one_line(tmp_path: Path) -> None:
    low = write(tmp_path / "low.yaml", "mapping: {integrator: projective, error_bound: 0.1}")
    high = write(tmp_path / "high.yaml", "behind: {policy: coarser_first, error_bound: 0.5}")
    layered = load_files([low, high])
    assert layered.config == Config()
    assert layered.notice == (
        f"{low}: mapping.error_bound was removed and is ignored, "
        "mapping.integrator: projective is now evidence_grid; "
        f"{high}: behind.policy was removed and is ignored, "
        "behind.error_bound was removed and is ignored"
    )
    assert layered.origins == {"mapping.integrator": str(low)}
    assert load_files([write(tmp_path / "new.yaml", "mapping: {detail: 2}")]).notice == ""


def test_ignored_settings_load_with_any_value_and_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    write(
        path,
        "octree: {use_cpp_backend: false, dynamic_expansion: 3}\n"
        "amcl: {scan_topic: /scan, map_service: [1], laser_z_max: 0.1, z_max: 0.1}\n"
        "visualization: {pointcloud_publish_rate: 2, show_opencv_visualization: true}\n",
    )
    layered = load_files([path])
    assert layered.config == Config()
    assert layered.origins == {}
    assert [name for name in IGNORED if f"{name} has no effect" in layered.notice] == list(IGNORED)
    assert not set(IGNORED) & set(parameters())


def test_lists_are_reported_as_a_whole(tmp_path: Path) -> None:
    low = write(tmp_path / "low.yaml", "odometry: {sources: [{name: a}, {name: b}]}")
    high = write(tmp_path / "high.yaml", "odometry: {sources: [{name: c}]}")
    layered = load_files([low, high])
    assert [source.name for source in layered.config.odometry.sources] == ["c"]
    assert layered.origin_of("odometry.sources") == str(high)


def test_rule_about_several_settings_holds_for_all_files_together(tmp_path: Path) -> None:
    low = write(tmp_path / "low.yaml", "mapping: {occupied_threshold: 0.4}")
    high = write(tmp_path / "high.yaml", "mapping: {free_threshold: 0.3}")
    other = write(tmp_path / "other.yaml", "octree: {voxel_resolution: 1}")
    assert load_files([low, high]).config.mapping.free_threshold == 0.3
    with pytest.raises(ConfigError) as caught:
        load_files([low, other])
    assert str(caught.value).startswith(f"{low}: $.mapping: free_threshold 0.5 ")
    assert caught.value.path == "$.mapping"


def test_rule_across_sections_names_all_files(tmp_path: Path) -> None:
    robots = write(tmp_path / "a.yaml", "robot_detection: {enabled: true, keep_out: true}")
    carving = write(tmp_path / "b.yaml", "mapping: {carve_no_return: true}")
    with pytest.raises(ConfigError, match=f"{robots} with {carving}: "):
        load_files([robots, carving])


def test_mistake_in_a_lower_file_is_no_secret(tmp_path: Path) -> None:
    low = write(tmp_path / "low.yaml", "octree: {voxel_resolution: big}")
    high = write(tmp_path / "high.yaml", "octree: {voxel_resolution: 0.1}")
    with pytest.raises(ConfigError, match=f"{low}: .*big is not allowed"):
        load_files([low, high])


def test_named_files_must_be_there(tmp_path: Path) -> None:
    environ = {"MAPPERD_CONFIG": str(tmp_path / "none.yaml")}
    with pytest.raises(ConfigError, match=r"none\.yaml: .*No such file"):
        load_settings([], environ, tmp_path)


def test_link_to_nowhere_is_an_error_not_the_defaults(tmp_path: Path) -> None:
    (tmp_path / "conf.d").mkdir()
    (tmp_path / "conf.d" / "a.yaml").symlink_to(tmp_path / "gone")
    with pytest.raises(ConfigError, match=r"a\.yaml: cannot be read"):
        load_settings([], {}, tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_folder_that_may_not_be_read_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "conf.d").mkdir(mode=0)
    with pytest.raises(ConfigError, match="cannot be read"):
        settings_files([], {}, tmp_path)


@pytest.mark.parametrize(
    ("text", "server", "ignored"),
    [
        (  # one address: with its token, whichever section had it
            "stream: {address: '0.0.0.0:2', token_file: /b, rate: 2}\ncontrol: {mode: '600'}",
            ServerConfig(address="0.0.0.0:2", token_file="/b", mode="600"),  # noqa: S106 a path
            [],
        ),
        (  # two: an address never gets the token or the certificate of the other
            """
            control: {address: '[::1]:1', token_file: /a}
            stream: {address: '0.0.0.0:2', token_file: /b, tls_certificate: /c, max_clients: 9}
            """,
            ServerConfig(address="[::1]:1", token_file="/a", max_clients=9),  # noqa: S106 a path
            ["stream.address", "stream.token_file", "stream.tls_certificate"],
        ),
        (  # the present name counts
            "server: {socket: /new}\ncontrol: {socket: /old}",
            ServerConfig(socket="/new"),
            ["control.socket"],
        ),
        ("control: {}\nstream:", ServerConfig(), []),
    ],
)
def test_sections_of_sockets_are_merged(
    tmp_path: Path, text: str, server: ServerConfig, ignored: list[str]
) -> None:
    layered = load_files([write(tmp_path / "mapperd.yaml", text)])
    assert layered.config.server == server
    found = re.findall(r"([a-z.]+_?[a-z]*) is ignored: server", layered.notice)
    assert found == ignored


@pytest.mark.parametrize("text", ["control: 0", "control: {other: 1}", "server: 3\ncontrol: {}"])
def test_errors_in_merged_sections_are_reported(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"control|server"):
        load_files([write(tmp_path / "mapperd.yaml", text)])


def test_the_origin_of_a_relative_file_holds_in_every_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("dive.yaml").write_text("filtering: {min_range: 1}\n")
    layered = load_settings([Path("dive.yaml")], {}, tmp_path / "none")
    assert layered.origin_of("filtering.min_range") == str(tmp_path / "dive.yaml")


@pytest.mark.parametrize(
    ("rule", "unused"),
    [("iwlo", ["arc.prior"]), ("arc", ["mapping.free_threshold", "mapping.detail", "iwlo.L_occ"])],
)
def test_settings_of_the_other_rule_are_named(tmp_path: Path, rule: str, unused: list[str]) -> None:
    path = tmp_path / "rule.yaml"
    path.write_text(
        f"mapping: {{rule: {rule}, free_threshold: 0.4, detail: 2, threads: 2}}\n"
        "arc: {prior: 0.1}\niwlo: {L_occ: 2}\nfiltering: {min_range: 1}\n"
    )
    notice = load_files([path]).notice
    assert notice.endswith(f"by mapping.rule {rule}: {', '.join(unused)}")
