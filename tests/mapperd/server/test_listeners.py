"""The sockets: who may connect, and what is in their way."""

import fcntl
import os
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import trustme

from mapperd.config.paths import socket_path, socket_places
from mapperd.config.tree import Config, ServerConfig, ServiceConfig
from mapperd.daemon.servers import open_listeners
from mapperd.errors import ConfigError, LiveError
from mapperd.events import EventLog, Severity
from mapperd.server.listeners import address_of, open_tcp_listener, open_unix_listener, server_tls
from mapperd.wire.auth import CREDENTIALS, read_token, token_file
from tests.support.control_server import TOKEN, is_listening

pytestmark = pytest.mark.net


@pytest.mark.parametrize("mode", [0o600, 0o660, 0o666])
def test_socket_has_its_permissions_whatever_the_umask(short: Path, mode: int) -> None:
    before = os.umask(0)
    try:
        listener = open_unix_listener(short / "sock", mode)
        assert os.umask(0) == 0
    finally:
        os.umask(before)
    assert stat.S_IMODE((short / "sock").stat().st_mode) == mode
    assert is_listening(short / "sock")
    listener.close()
    assert [path.name for path in short.iterdir()] == [".sock.lock"]


def test_socket_of_a_dead_process_is_replaced(short: Path) -> None:
    path = short / "sock"
    code = (
        "import sys, os; from pathlib import Path; "
        "from mapperd.server.listeners import open_unix_listener; "
        "open_unix_listener(Path(sys.argv[1]), 0o600); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", code, path], check=False, timeout=60)  # noqa: S603
    assert path.is_socket()
    assert not is_listening(path)
    listener = open_unix_listener(path, 0o600)
    assert is_listening(path)
    listener.close()


def test_living_daemon_keeps_its_socket(short: Path) -> None:
    listener = open_unix_listener(short / "sock", 0o600)
    with pytest.raises(LiveError, match="another process listens there"):
        open_unix_listener(short / "sock", 0o600)
    assert is_listening(short / "sock")
    listener.close()


def test_another_program_keeps_its_socket_even_without_a_lock(short: Path) -> None:
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(short / "sock"))
        other.listen()
        with pytest.raises(LiveError, match="another process listens there"):
            open_unix_listener(short / "sock", 0o600)
        assert is_listening(short / "sock")


def test_two_that_start_at_once_do_not_take_it_from_each_other(short: Path) -> None:
    with (short / ".sock.lock").open("w") as other:  # it looks whether the place is free
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(LiveError, match="another process listens there"):
            open_unix_listener(short / "sock", 0o600)
        assert not (short / "sock").exists()
    open_unix_listener(short / "sock", 0o600).close()


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_no_socket_is_left_alone(short: Path, kind: str) -> None:
    path = short / "sock"
    if kind == "file":
        path.write_text("precious", encoding="utf-8")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/etc/passwd")
    with pytest.raises(LiveError, match="socket"):
        open_unix_listener(path, 0o600)
    assert path.is_symlink() == (kind == "link")
    assert sorted(one.name for one in short.iterdir()) == [".sock.lock", "sock"]


def test_socket_that_was_replaced_is_not_removed(short: Path) -> None:
    path = short / "sock"
    listener = open_unix_listener(path, 0o600)
    path.unlink()
    (short / ".sock.lock").unlink()
    other = open_unix_listener(path, 0o600)
    listener.close()
    assert is_listening(path)
    other.close()


@pytest.mark.parametrize("path", ["/proc/none/sock", "/" + "x" * 200])
def test_socket_that_cannot_be_is_one_line(path: str) -> None:
    with pytest.raises(LiveError, match="cannot be listened on") as caught:
        open_unix_listener(Path(path), 0o600)
    assert str(caught.value).isprintable()


def test_address_in_use_is_one_line() -> None:
    listener = open_tcp_listener("127.0.0.1:0", TOKEN, None)
    port = listener.socket.getsockname()[1]
    assert listener.name == f"tcp 127.0.0.1:{port}"
    with pytest.raises(LiveError, match="in use"):
        open_tcp_listener(f"127.0.0.1:{port}", TOKEN, None)
    listener.close()


@pytest.mark.parametrize(
    "text", ["", "7470", ":7470", "host:7470", "127.0.0.1", "127.0.0.1:", "127.0.0.1:70000",
             "127.0.0.1:-1", "::1:7470", "[127.0.0.1]:1", "300.0.0.1:1", "127.0.0.1:\u0661"],
)  # fmt: skip
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"such as 127\.0\.0\.1:7470|expected|Octet"):
        address_of(text)


def test_addresses_are_read() -> None:
    assert [str(address_of(text)[0]) for text in ("localhost:1", "[::1]:7470", "0.0.0.0:1")] == [
        "127.0.0.1",
        "::1",
        "0.0.0.0",  # noqa: S104 it is only read
    ]


@pytest.mark.parametrize(
    ("content", "mode", "because"),
    [
        (TOKEN, 0o604, "everybody may read it"),
        (TOKEN, 0o602, "everybody may read it or write"),
        (b"short", 0o600, "16 or more printable characters"),
        (b"", 0o600, "16 or more"),
        (b"two words of a long token", 0o600, "one word"),
        (b"x" * 2000, 0o600, "one word"),
        ("ünprintable-but-long-enough".encode(), 0o600, "one word"),
    ],
)
def test_bad_token_file_is_refused(tmp_path: Path, content: bytes, mode: int, because: str) -> None:
    path = tmp_path / "token"
    path.write_bytes(content)
    path.chmod(mode)
    with pytest.raises(ConfigError, match=because) as caught:
        read_token(path)
    assert caught.value.path == "$.server.token_file"


def test_token_is_found_among_the_credentials(tmp_path: Path) -> None:
    assert token_file("", {}) is None
    environ = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    assert token_file("", environ) is None
    for name in reversed(CREDENTIALS):  # those of earlier versions count until the present one
        (tmp_path / name).write_bytes(TOKEN + b"\n")
        (tmp_path / name).chmod(0o400)
        assert token_file("", environ) == tmp_path / name
    assert read_token(tmp_path / CREDENTIALS[0]) == TOKEN
    assert token_file("/given", environ) == Path("/given")
    with pytest.raises(ConfigError, match="credentials cannot be read"):
        token_file("", {"CREDENTIALS_DIRECTORY": "/x" * 5000})
    with pytest.raises(ConfigError, match="cannot be read"):
        read_token(tmp_path / "none")


def test_place_of_the_socket() -> None:
    config = Config(service=ServiceConfig(state_folder="/state"))
    user, service = {"XDG_RUNTIME_DIR": "/run/user/7"}, {"RUNTIME_DIRECTORY": "/run/m:/run/n"}
    assert socket_path(config, {}) == Path("/state/mapperd.sock")
    assert socket_path(config, user) == Path("/run/user/7/mapperd.sock")
    assert socket_path(config, user | service) == Path("/run/m/mapperd.sock")
    assert socket_places(config, user | service) == [
        Path("/run/user/7/mapperd.sock"),
        Path("/run/mapperd/mapperd.sock"),
        Path("/state/mapperd.sock"),
    ]
    output = Config(server=ServerConfig(socket="/a/b"))
    assert socket_path(output, user) == Path("/a/b")
    assert socket_places(output, user) == [Path("/a/b")]


class TestSetup:
    def test_loopback_alone_without_a_word(self, short: Path) -> None:
        events = EventLog(lambda: 0)
        (listener,) = open_listeners(Config(), events, {"XDG_RUNTIME_DIR": str(short)})
        assert listener.name == f"unix {short}/mapperd.sock"
        listener.close()
        assert events.last == 0

    @pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])  # noqa: S104 a port of its own
    def test_network_without_tls_is_reported(self, short: Path, host: str) -> None:
        (short / "token").write_bytes(TOKEN)
        (short / "token").chmod(0o600)
        server = ServerConfig(address=f"{host}:0", token_file=f"{short}/token", mode="600")
        events = EventLog(lambda: 0)
        environ = {"XDG_RUNTIME_DIR": str(short)}
        for listener in open_listeners(Config(server=server), events, environ):
            assert (listener.token is None) == listener.name.startswith("unix")
            listener.close()
        sent = [(event.severity, event.code) for event in events.since(0)[0]]
        in_clear = [(Severity.WARNING, "server_in_clear")]
        assert sent == ([] if host == "127.0.0.1" else in_clear)

    @pytest.mark.parametrize(
        ("output", "because"),
        [
            ({"token_file": "", "address": "0.0.0.0:0"}, "needs a token"),
            ({"address": "somewhere:0"}, "not an address"),
            ({}, "cannot be read"),
            ({"tls_key": "k"}, "no certificate"),
            ({"tls_certificate": "c"}, "its key"),
        ],
    )
    def test_bad_settings_leave_no_socket(
        self, short: Path, output: dict[str, str], because: str
    ) -> None:
        server = ServerConfig(**{"address": "127.0.0.1:0", "token_file": "/none"} | output)  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=because) as caught:
            open_listeners(
                Config(server=server),
                EventLog(lambda: 0),
                {"XDG_RUNTIME_DIR": str(short)},
            )
        assert caught.value.path.startswith("$.server.")
        assert [path.name for path in short.iterdir()] == [".mapperd.sock.lock"]


def test_certificate_with_its_key_is_taken(tmp_path: Path) -> None:
    issued = trustme.CA().issue_cert("localhost")
    chain, key = tmp_path / "chain.pem", tmp_path / "key.pem"
    issued.cert_chain_pems[0].write_to_path(str(chain))
    issued.private_key_pem.write_to_path(str(key))
    assert server_tls(str(chain), str(key)).get_ca_certs() == []
    with pytest.raises(ConfigError, match="its key"):
        server_tls(str(chain), str(chain))
