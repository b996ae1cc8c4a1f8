"""Shared by all tests: tiers, hypothesis profiles, folders."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]

QUICK = "not slow and not net and not browser and not crash"

# A busy machine fails no example: there is no deadline.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
# The same examples in every run; `pytest --hypothesis-profile=random` looks for new ones.
settings.register_profile("seeded", settings.get_profile("untimed"), derandomize=True)
settings.register_profile("random", settings.get_profile("untimed"), derandomize=False)
settings.load_profile("seeded")


def _is_whole_suite(config: pytest.Config) -> bool:
    """Whether the command line names no file or folder."""
    return config.args_source is not pytest.Config.ArgsSource.ARGS


def pytest_configure(config: pytest.Config) -> None:
    """Run the quick tests unless the command line selects others by path or marker."""
    if _is_whole_suite(config) and not config.option.markexpr:
        config.option.markexpr = QUICK


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Use all cores for the whole suite, and this process for named files."""
    return (os.cpu_count() or 1) if _is_whole_suite(config) else 0


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep recordings and maps of tests out of the user's folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        for name in ("STATE_DIRECTORY", "LOGS_DIRECTORY"):
            patch.delenv(name, raising=False)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real captures, beside the repository; skip the test without it."""
    folder = ROOT / ".." / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real captures are not beside this repository (../shared/data)")
    return folder.resolve()
