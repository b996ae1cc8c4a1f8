"""A built copy of the repository's last commit, in which files are broken."""

import fcntl
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mutations.catalogue import REPOSITORY, Mutation, mutated

__all__ = ["Copy", "NotBuiltError"]

PINNED = Path(__file__).resolve().parent / "pinned"
MODULES = ("_core", "acoustics_core")


class NotBuiltError(Exception):
    """Message of the compiler."""


class Copy:
    """A clone in a folder, with its own build tree that is kept between runs."""

    def __init__(self, folder: Path, jobs: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        folder = folder.resolve()  # the form in which programs report imports
        self._lock = (folder / "lock").open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SystemExit(f"another mutation check is at work in {folder}") from None
        self.root = folder / "tree"
        self.build_tree = self.root / "build" / "release"
        self.whole = folder / "whole"
        self._kept: set[str] = set()
        self._jobs = jobs
        self._witness = folder / "witness"
        if not self.root.exists():
            _run(["git", "clone", "--quiet", "--shared", str(REPOSITORY), str(self.root)])
        _run(["git", "fetch", "--quiet", "origin", "HEAD"], self.root)
        # Write only files that differ, so that the build tree stays valid.
        _run(["git", "checkout", "--quiet", "--force", "--detach", "FETCH_HEAD"], self.root)
        self.commit = _run(["git", "rev-parse", "--short", "HEAD"], self.root).strip()

    def configure(self) -> None:
        """Create the build tree without warnings, because broken code may cause some."""
        packages = sysconfig.get_path("purelib")
        prefixes = f"{packages}/cmeel.prefix;{packages}/pybind11"
        _run(
            [
                *("cmake", "-S", "cpp", "-B", str(self.build_tree), "-G", "Ninja"),
                *("-DCMAKE_BUILD_TYPE=Release", "-DMAPPERD_BUILD_TESTS=ON"),
                *("-DCMAKE_CXX_FLAGS=-w", f"-DPython_EXECUTABLE={sys.executable}"),
                f"-DCMAKE_PREFIX_PATH={prefixes}",
            ],
            self.root,
        )

    def build(self, targets: Sequence[str]) -> None:
        """Compile targets that are not up to date.

        Raises:
            NotBuiltError: it does not compile.
        """
        _run(["ninja", "-C", str(self.build_tree), "-j", str(self._jobs), *targets], self.root)
        if not set(MODULES) & set(targets):
            return
        for built, package in (("mapperd", "mapperd"), ("sonar_sim", "tools/sonar_sim")):
            for module in (self.build_tree / built).glob("_core.*.so"):
                link = self.root / package / module.name
                link.unlink(missing_ok=True)
                link.symlink_to(module)

    def keep_whole(self, program: str) -> None:
        """Build an unbroken test program once and keep it in `whole`.

        A failed test can then run unbroken without another build.
        """
        if program and program not in self._kept:
            self.build([program])
            self.whole.mkdir(exist_ok=True)
            shutil.copy2(self.build_tree / "test" / program, self.whole)
            self._kept.add(program)

    @contextmanager
    def broken(self, mutation: Mutation) -> Iterator[None]:
        """Apply a mutation to a file during the context."""
        path = self.root / mutation.file
        whole = path.read_text()
        _write(path, mutated(mutation, whole))
        try:
            yield
        finally:
            _write(path, whole)

    def environment(self, mutation: Mutation | None) -> dict[str, str]:
        """Return the environment in which programs import the copy's packages."""
        self._witness.unlink(missing_ok=True)
        paths = (PINNED, self.root, self.root / "tools")
        variables = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
        if mutation is not None:
            variables["MUTATIONS_FILE"] = str(self.root / mutation.file)
            variables["MUTATIONS_WITNESS"] = str(self._witness)
        return variables

    @property
    def was_imported(self) -> bool:
        """Return whether a program since `environment` imported the mutated file."""
        return self._witness.exists()


def _write(path: Path, text: str) -> None:
    """Write a file, and remove its compiled form, which may have the same second and size."""
    path.write_text(text)
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()


def _run(words: Sequence[str], folder: Path | None = None) -> str:
    here = Path(sys.executable).parent  # cmake and ninja are installed next to Python
    variables = {**os.environ, "PATH": f"{here}{os.pathsep}{os.environ['PATH']}"}
    ended = subprocess.run(  # noqa: S603
        list(words), cwd=folder, env=variables, capture_output=True, text=True, check=False
    )
    if ended.returncode != 0:
        raise NotBuiltError(f"{' '.join(words)}\n{ended.stdout[-3000:]}{ended.stderr[-3000:]}")
    return ended.stdout
