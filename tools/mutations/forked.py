"""Runs pytest in a fork of this process, which has already imported the slow packages.

A separate program would import for seconds before tests of a tenth of a second.
"""

import contextlib
import importlib
import os
import pkgutil
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from signal import SIGKILL

import pytest

from mutations.catalogue import REPOSITORY

__all__ = ["run_forked"]

# Third-party imports of the copy's packages and tests, which are never mutated.
FOREIGN = (
    *("numpy", "numpy.random", "numpy.testing", "scipy.interpolate", "scipy.ndimage"),
    *("scipy.signal", "scipy.spatial", "scipy.special", "trimesh", "PIL.Image", "cv2"),
    *("hypothesis", "hypothesis.strategies", "hypothesis.extra.numpy", "_hypothesis_pytestplugin"),
    *("xdist", "pytest_timeout", "msgspec", "msgpack", "yaml", "zstandard"),
    *("asyncio", "http.client", "sqlite3", "ssl", "uuid"),
)
ALREADY_IMPORTED = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
WAIT_S = 0.02


def run_forked(
    options: Sequence[str], folder: Path, environment: Mapping[str, str], timeout_s: float
) -> tuple[int | None, str]:
    """Run pytest's main function in a folder.

    Returns:
        Its exit code, negative for a signal, None after a timeout; and its output.
    """
    _import_foreign()
    with tempfile.TemporaryFile() as printed:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            _run_in_child(options, folder, environment, printed.fileno())
        code = _awaited(child, timeout_s)
        printed.seek(0)
        return code, printed.read().decode(errors="replace")


def _import_foreign() -> None:
    for name in FOREIGN:
        with contextlib.suppress(ImportError):  # extras that are not installed
            pkgutil.resolve_name(name)


def _run_in_child(
    options: Sequence[str], folder: Path, environment: Mapping[str, str], printed: int
) -> None:
    """Never returns."""
    code = 70
    try:
        os.setsid()  # its child processes end with it
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        _forget_our_packages()
        sys.path[:0] = environment["PYTHONPATH"].split(os.pathsep)
        sys.modules.pop("sitecustomize", None)
        pinned = importlib.import_module("sitecustomize")
        code = int(pytest.main([*options, *ALREADY_IMPORTED]))
        if "MUTATIONS_FILE" in environment:
            mutated, witness = environment["MUTATIONS_FILE"], environment["MUTATIONS_WITNESS"]
            pinned.bear_witness(Path(mutated), Path(witness))
    except BaseException:  # noqa: BLE001 whatever it is, the child must end here
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _forget_our_packages() -> None:
    """Remove our packages, so that those of the copy are imported."""
    ours = str(REPOSITORY) + os.sep
    sys.path[:] = [path for path in sys.path if path and not _is_ours(Path(path))]
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if file is not None and file.startswith(ours) and not _is_installed(file):
            del sys.modules[name]


def _is_ours(path: Path) -> bool:
    return path.resolve().is_relative_to(REPOSITORY) and not _is_installed(str(path))


def _is_installed(path: str) -> bool:
    return "site-packages" in path


def _awaited(child: int, timeout_s: float) -> int | None:
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(WAIT_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, SIGKILL)
    os.waitpid(child, 0)
    return None
