import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

from mapperd.config.loader import config_of
from mapperd.config.paths import read_secret
from mapperd.errors import ConfigError
from mapperd.telemetry.broker import check_telemetry


def check(settings: dict[str, Any], environment: dict[str, str] | None = None) -> None:
    tree = settings if "mqtt" in settings else {"mqtt": {"host": "shore", **settings}}
    check_telemetry(config_of(tree, ""), environment or {})


def test_without_a_broker_nothing_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    check({"mqtt": {"password_file": "/nowhere"}})
    with pytest.raises(ConfigError, match=r"`mqtt`: \S+ -m pip install 'aiomqtt"):
        check({})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"password_file": "/nowhere/secret", "username": "u"}, "/nowhere/secret: No such file"),
        ({"tls": True, "ca_file": "/nowhere/ca.pem"}, r"mqtt\.ca_file: /nowhere/ca.pem: No such"),
        ({"tls": True, "ca_file": __file__}, r"mqtt\.ca_file: "),
    ],
)
def test_files_that_cannot_be_read_are_named_at_the_start(
    settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        check(settings)


def test_a_password_needs_a_user(tmp_path: Path) -> None:
    (tmp_path / "mqtt-password").write_text("secret", encoding="utf-8")
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    check({"username": "rov"}, environment)
    with pytest.raises(ConfigError, match=r"mqtt\.username: a password needs one"):
        check({}, environment)


@pytest.mark.parametrize("topic", ["/pose", "status", "/cmd/reset", "amcl_pose", "/map_odom"])
def test_robots_have_a_topic_of_their_own(topic: str) -> None:
    tree = {"mqtt": {"host": "shore"}, "robot_detection": {"topic": topic}}
    with pytest.raises(ConfigError, match="amcl_pose, changes, cmd, config"):
        check(tree)


def test_secret_is_the_first_line_of_the_file_or_of_the_credential(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("right\r\nnot this\n", encoding="utf-8")
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    assert read_secret("a.b", str(file), "token", {}) == "right"
    assert read_secret("a.b", "", "token", environment) == "right"
    assert read_secret("a.b", "", "other", environment) is None
    assert read_secret("a.b", "", "token", {}) is None


def test_secret_that_everybody_may_write_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("right", encoding="utf-8")
    for mode in (0o600, 0o640, 0o644, 0o660):
        file.chmod(mode)
        assert read_secret("mqtt.password_file", str(file), "token", {}) == "right"
    file.chmod(0o602)
    with pytest.raises(ConfigError, match="everybody may write to it"):
        read_secret("mqtt.password_file", str(file), "token", {})


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "is empty"), (b"\xff", "is no text"), (b"x" * 5000, "longer than")]
)
def test_what_is_no_secret_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "token"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        read_secret("control.token_file", str(file), "token", {})
    assert caught.value.path == "$.control.token_file"


def test_the_extra_is_not_imported_where_nothing_is_reported() -> None:
    code = "import sys, mapperd.telemetry.telemetry; print('aiomqtt' in sys.modules)"
    import subprocess  # noqa: PLC0415 of this test alone

    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
