"""How a session's localization begins: its map is loaded, its saved pose is read.

A replayed session begins with the state in its recording, not with what lies on the disk
now: the saved pose stands in the recording, and of the map its fingerprint.
"""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import CheckpointError, ConfigError, MapError
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.known_map import KnownMap, load_known_map
from mapperd.localization.stage import LocalizationStage, LocalizationStageState
from mapperd.session_log import Numbers12, Session
from mapperd.store.checkpoint import decode_state, encode_state

__all__ = [
    "KnownMaps",
    "LocalizationSession",
    "begun",
    "begun_again",
    "numbers_of",
    "poses_depend_on",
    "restored_session",
    "saved_state",
]

PLACE = "$.localization.map_path"


class KnownMaps:
    """Maps on their way to localization: loaded in one thread, taken in another.

    Args:
        config: what maps are loaded by.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._ready: dict[tuple[str, str], list[KnownMap]] = {}
        self._lock = threading.Lock()

    @property
    def config(self) -> Config:
        """What maps are loaded by."""
        return self._config

    def load(self, path: str) -> KnownMap:
        """Load a map; not in an event loop.

        Raises:
            MapError: as `load_known_map`.
        """
        return load_known_map(Path(path), self._config)

    def offer(self, known: KnownMap) -> None:
        """Have a map ready for one `take`, whatever becomes of its file until then."""
        with self._lock:
            self._ready.setdefault((known.path, known.sha256), []).append(known)

    def take(self, path: str, sha256: str) -> KnownMap:
        """Give a map away, loaded now where none is ready, as when a session is mapped again.

        Raises:
            CheckpointError: it cannot be loaded, or is another one by now.
        """
        known = self._offered(path, sha256)
        try:
            known = known or load_known_map(Path(path), self._config)
        except MapError as error:
            raise CheckpointError(str(error)) from error
        if known.sha256 != sha256:
            raise CheckpointError(
                f"{path}: another map than the one that the session was localized on"
            )
        return known

    def _offered(self, path: str, sha256: str) -> KnownMap | None:
        with self._lock:
            ready = self._ready.get((path, sha256))
            if not ready:
                return None
            known = ready.pop()
            if not ready:
                del self._ready[path, sha256]
            return known


@dataclass(frozen=True, slots=True)
class LocalizationSession:
    """A session's localization as it begins.

    Attributes:
        stage: for the thread that maps.
        maps: through which it gets other maps.
        saved: estimate that it goes on from.
        map_sha256: of the map that it begins with; empty without one.
    """

    stage: LocalizationStage
    maps: KnownMaps
    saved: PlanarGaussian | None = None
    map_sha256: str = ""


def begun(config: Config, saved: PlanarGaussian | None = None) -> LocalizationSession | None:
    """Begin by the settings; None where localization is off. Not in an event loop.

    Args:
        config: the settings.
        saved: estimate from before a restart, or None.

    Raises:
        ConfigError: the map cannot be used.
    """
    ours = config.localization
    if ours.mode == "off":
        return None
    maps = KnownMaps(config)
    try:
        known = load_known_map(Path(ours.map_path), config) if ours.map_path else None
    except MapError as error:
        raise ConfigError(f"{PLACE}: {error}", PLACE) from error
    return _session(config, maps, known, saved)


def begun_again(config: Config, session: Session) -> LocalizationSession | None:
    """Begin as a recorded session began; None where localization was off.

    Raises:
        ConfigError: the map cannot be used, or is another one by now.
    """
    ours = config.localization
    if ours.mode == "off":
        return None
    maps = KnownMaps(config)
    try:
        known = maps.take(ours.map_path, session.map_sha256) if session.map_sha256 else None
    except CheckpointError as error:
        raise ConfigError(f"{PLACE}: {error}", PLACE) from error
    return _session(config, maps, known, _gaussian(session.saved_pose))


def poses_depend_on(localizing: LocalizationSession | None) -> LocalizationSession | None:
    """Return `localizing` if it affects the map, otherwise None."""
    if localizing is None or localizing.maps.config.localization.mapping == "odometry":
        return None
    return localizing


class _SavedState(NamedTuple):
    """State of the stage, and the settings that maps are loaded by, as plain values."""

    stage: LocalizationStageState
    loaded_by: dict[str, Any]


def saved_state(localizing: LocalizationSession) -> bytes:
    """All that `restored_session` needs; in the thread that maps."""
    loaded_by = msgspec.to_builtins(localizing.maps.config)
    return encode_state(_SavedState(localizing.stage.state(), loaded_by))


def restored_session(config: Config, data: bytes) -> LocalizationSession:
    """Localization as it was when `saved_state` was called.

    Args:
        config: the settings in force then.
        data: of `saved_state`.

    Raises:
        CheckpointError: the bytes are damaged or of another format, or the map is not there.
    """
    state, loaded_by = decode_state(data, _SavedState)
    try:
        maps = KnownMaps(config_of(loaded_by, "the checkpoint"))
        known = maps.take(state.path, state.sha256) if state.sha256 else None
        stage = LocalizationStage(config, load=maps.take)
        stage.restore(state, known)
    except (ConfigError, MapError, ValueError, TypeError) as error:
        raise CheckpointError(f"localization cannot go on: {error}") from error
    return LocalizationSession(stage, maps)


def numbers_of(pose: PlanarGaussian | None) -> Numbers12 | None:
    """A pose as a recording has it."""
    if pose is None:
        return None
    (a, b, c), (d, e, f), (g, h, i) = pose.covariance.tolist()
    return pose.x_m, pose.y_m, pose.yaw_rad, a, b, c, d, e, f, g, h, i


def _gaussian(numbers: Numbers12 | None) -> PlanarGaussian | None:
    if numbers is None:
        return None
    return PlanarGaussian(*numbers[:3], np.array(numbers[3:]).reshape(3, 3))


def _session(
    config: Config, maps: KnownMaps, known: KnownMap | None, saved: PlanarGaussian | None
) -> LocalizationSession:
    try:
        stage = LocalizationStage(config, known, saved, maps.take)
    except MapError as error:
        raise ConfigError(f"{PLACE}: {error}", PLACE) from error
    except ValueError as error:
        raise ConfigError(f"$.amcl: {error}", "$.amcl") from error
    return LocalizationSession(stage, maps, saved, "" if known is None else known.sha256)
