"""Shell blocks of a page of docs/, and a folder in which they run as a reader would run them."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_S = 900.0
READY_TIMEOUT_S = 240.0
STOP_TIMEOUT_S = 60.0
POLL_S = 0.2
SERVICE_FOLDERS = ("STATE_DIRECTORY", "LOGS_DIRECTORY", "RUNTIME_DIRECTORY")
"""Variables that systemd sets for a service; the shell of a reader has none of them."""

_BLOCK = re.compile(
    r"^(?:<!-- (?P<marker>[^\n]*?) -->\n)?^```(?:sh|console)\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
_FILE = re.compile(r'^```\w+ title="(?P<name>[^"]+)"\n(?P<text>.*?)^```$', re.DOTALL | re.MULTILINE)

SCENE = """
description: A level floor and a short path above it.
water: {temperature_c: 12, salinity_ppt: 33, depth_m: 4}
terrain:
  relief: {kind: flat, depth_m: 6.0}
  x_m: [-12, 12]
  y_m: [-12, 12]
  cell_m: 0.5
  material: sand
sonar: {model: M750d, mode: 1, range_m: 8, ping_rate_hz: 5}
mounting: {position_m: [0.0, 0.0, -0.3], pitch_deg: 90}
trajectory:
  waypoints:
    - {position_m: [-1, 0, -2.5], yaw_deg: 0}
    - {position_m: [1, 0, -2.5], yaw_deg: 0}
vehicle:
  name: survey boat
  odometry: {position_noise_m: 0.01, attitude_noise_deg: 0.1}
"""


@dataclass(frozen=True)
class Block:
    """A shell block of a page.

    Attributes:
        code: its commands.
        ready: command that succeeds once the block's program answers; only of programs that run
            in the background until the page ends.
        ended: the program in the background that Ctrl-C ends before, or "".
        until: command after whose success Ctrl-C ends each line, a program of its own, or "".
        tested: the test that runs it instead, as pytest names it, or "".
        shown: command that succeeds soon after the block, and shows that it had an effect, or "".
    """

    code: str
    ready: str = ""
    ended: str = ""
    until: str = ""
    tested: str = ""
    shown: str = ""


def blocks_of(page: Path) -> list[Block]:
    """The shell blocks of a page, in order.

    Raises:
        ValueError: a marker is not `run by: TEST`, `background: COMMAND`,
            `until: COMMAND`, `then: COMMAND` or `ctrl-c: PROGRAM`.
    """
    return [_block(match) for match in _BLOCK.finditer(page.read_text("utf-8"))]


_ATTRIBUTES = {
    "background": "ready",
    "ctrl-c": "ended",
    "run by": "tested",
    "then": "shown",
    "until": "until",
}
"""By the kind of marker."""


def _block(match: re.Match[str]) -> Block:
    marker = match["marker"] or ""
    kind, _, rest = marker.partition(": ")
    code = re.sub(r"^\$ ", "", match["code"], flags=re.MULTILINE)
    if not marker:
        return Block(code)
    if rest and kind in _ATTRIBUTES:
        return Block(code, **{_ATTRIBUTES[kind]: rest})
    raise ValueError(f"unknown marker: {marker}")


_LOOPBACK_UP = """
import fcntl, socket, struct, sys
with socket.socket() as up:
    fcntl.ioctl(up, 0x8914, struct.pack("16sH14x", b"lo", 0x41))
print("up", flush=True)
sys.stdin.read()
"""


@contextmanager
def own_network() -> Iterator[list[str]]:
    """The words before a command that run it in a network with nothing but a loopback.

    So no other test meets a page's sonar. The commands are root there, and what they mount stays
    there too. Empty if the system has no such networks.
    """
    unshare, nsenter = shutil.which("unshare"), shutil.which("nsenter")
    if unshare is None or nsenter is None:
        yield []
        return
    apart = [unshare, "--user", "--map-root-user", "--net", "--mount"]
    with subprocess.Popen(  # noqa: S603 our own commands
        [*apart, sys.executable, "-c", _LOOPBACK_UP],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        words = [nsenter, "--preserve-credentials", "-U", "-n", "-m", "-t", str(holder.pid)]
        yield words if holder.stdout.readline() == "up\n" else []
        holder.stdin.close()


class Reader:
    """Somebody who follows a page in an empty folder, with the project's commands installed.

    Args:
        folder: where the commands run.
        runtime: folder for sockets.
        network: from `own_network`.
        installed: folder of installed commands; None: those of this checkout.

    Attributes:
        folder: where the commands run.
        network: words before a command that run it in the reader's network.
    """

    def __init__(
        self,
        folder: Path,
        runtime: Path,
        network: Sequence[str] = (),
        installed: Path | None = None,
    ) -> None:
        """Prepare the commands of pyproject.toml and folders of its own."""
        self.network = list(network)
        self._shell = [*network, "/bin/bash"]
        self._programs: dict[str, subprocess.Popen[bytes]] = {}
        self.folder = folder / "work"
        self.folder.mkdir()
        commands = installed or folder / "bin"
        if installed is None:
            commands.mkdir()
            self._install(commands)
        parts = () if installed else (".", "tools")
        usual = {name: text for name, text in os.environ.items() if name not in SERVICE_FOLDERS}
        self.environment = usual | {
            "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
            "HOME": str(folder),
            "XDG_STATE_HOME": str(folder / ".local" / "state"),
            "XDG_RUNTIME_DIR": str(runtime),
            "PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in parts),
            "BROWSER": "true",
        }
        self._commands = folder / "stand-ins"

    @staticmethod
    def _install(commands: Path) -> None:
        scripts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["scripts"]
        for name, place in scripts.items():
            module, _, function = place.partition(":")
            (commands / name).write_text(
                f"#!{sys.executable}\nimport sys\nfrom {module} import {function}\n"
                f'if __name__ == "__main__":\n    sys.exit({function}())\n'
            )
            (commands / name).chmod(0o755)

    def add_command(self, name: str, script: str) -> None:
        """Put a script before the command of that name."""
        if not self._commands.exists():
            self._commands.mkdir()
            self.environment["PATH"] = f"{self._commands}{os.pathsep}{self.environment['PATH']}"
        (self._commands / name).write_text(script)
        (self._commands / name).chmod(0o755)

    def run(self, code: str) -> subprocess.CompletedProcess[str]:
        """Run commands; stop at the first that fails."""
        process = subprocess.Popen(  # noqa: S603 commands of our own pages
            self._words(code),
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            out, err = process.communicate(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            out, err = process.communicate()
            raise AssertionError(f"still running after {TIMEOUT_S} s: {code}\n{out}{err}") from None
        return subprocess.CompletedProcess(code, process.returncode, out, err)

    def _words(self, code: str) -> list[str]:
        """The shell; entering a file system of one's own leads to its root."""
        place = shlex.quote(str(self.folder))
        return [*self._shell, "-euo", "pipefail", "-c", f"cd {place}\n{code}"]

    def wait_for(self, command: str, alive: Callable[[], object] = lambda: None) -> None:
        """Wait until a command succeeds; call `alive` between the attempts.

        Raises:
            AssertionError: it did not for `READY_TIMEOUT_S`.
        """
        end = time.monotonic() + READY_TIMEOUT_S
        while (done := self.run(command)).returncode != 0:
            alive()
            assert time.monotonic() < end, (
                f"{command} failed for {READY_TIMEOUT_S} s\n{done.stdout}{done.stderr}"
            )
            time.sleep(POLL_S)

    def end(self, program: str) -> None:
        """Press Ctrl-C in the terminal of a program in the background, and wait for its end."""
        process = self._programs.pop(program)
        process.send_signal(signal.SIGINT)
        assert process.wait(STOP_TIMEOUT_S) in (0, 130)

    def write_scene(self) -> None:
        """Write scene.yaml, a floor."""
        (self.folder / "scene.yaml").write_text(SCENE)

    def simulate_dive(self) -> None:
        """Record dive.mcap, four seconds above a floor."""
        self.write_scene()
        done = self.run("sonar-sim capture scene.yaml --out dive.mcap")
        assert done.returncode == 0, done.stderr

    @contextmanager
    def background(self, block: Block) -> Iterator[None]:
        """A program that answers `block.ready` inside, and ends properly at an interrupt.

        Lines before the last are run first. `block.ready` finds the output in the file $OUTPUT.
        """
        *before, last = block.code.strip().splitlines()
        program = last.split()[0]
        output = self.folder / f"output-{time.monotonic_ns()}.log"
        with output.open("w") as log:
            process = subprocess.Popen(  # noqa: S603 commands of our own pages
                self._words("\n".join([*before, f"exec {last}"])),
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

        def runs() -> None:
            assert process.poll() is None, f"{block.code}\n{output.read_text()}"

        try:
            self.wait_for(f"OUTPUT={output}; {block.ready} || {{ cat $OUTPUT; false; }}", runs)
            earlier = self._programs.get(program)
            self._programs[program] = process
            yield
            if self._programs.get(program) is process:
                self.end(program)
            if earlier is not None:
                self._programs[program] = earlier
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


def follow(
    page: Path,
    folder: Path,
    *,
    installed: Path | None = None,
    stage: Callable[[Reader, ExitStack], None] | None = None,
    after: Callable[[Block, Reader], bool] = lambda *_: True,
) -> None:
    """Run the shell blocks of a page one after the other.

    Files that the page shows with a title are there from the beginning, and so is dive.mcap if
    the page reads it without recording it.

    Args:
        page: the page.
        folder: the reader's home.
        installed: folder of installed commands; None: those of this checkout.
        stage: makes ready what the page expects: programs and files.
        after: called after each block; returns whether to go on.

    Raises:
        AssertionError: a block failed.
    """
    blocks = [block for block in blocks_of(page) if not block.tested]
    with ExitStack() as stack:
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="mapperd-docs-"))
        network = stack.enter_context(own_network())
        if not network and (
            stage or any(block.ready for block in blocks)
        ):  # a sonar's ports exist once
            lock = stack.enter_context(
                (Path(tempfile.gettempdir()) / "mapperd-docs.lock").open("w")
            )
            fcntl.flock(lock, fcntl.LOCK_EX)
        reader = Reader(folder, Path(runtime), network, installed)
        files = {match["name"]: match["text"] for match in _FILE.finditer(page.read_text("utf-8"))}
        for name, text in files.items():
            (reader.folder / name).write_text(text)
        read = "".join([*files.values(), *(block.code for block in blocks)])
        if "dive.mcap" in read and "--out dive.mcap" not in read:
            reader.simulate_dive()
        if stage is not None:
            stage(reader, stack)
        for block in blocks:
            _follow_block(block, reader, stack)
            if not after(block, reader):
                return


def _follow_block(block: Block, reader: Reader, stack: ExitStack) -> None:
    if block.ready:
        stack.enter_context(reader.background(block))
        return
    if block.until:
        for line in block.code.splitlines():
            with reader.background(Block(line, ready=block.until)):
                pass
        return
    if block.ended:
        reader.end(block.ended)
    done = reader.run(block.code)
    assert done.returncode == 0, f"{block.code}\n{done.stdout}\n{done.stderr}"
    if block.shown:
        reader.wait_for(block.shown)
