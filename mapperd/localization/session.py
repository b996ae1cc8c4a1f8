"""Starts a session's localization: loads its map and its saved pose.

A replayed session starts with the state in its recording, not with the files on disk: the recording
holds the saved pose and the fingerprint of the map.
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
    """Passes maps to localization: loaded in one thread, taken in another.

    Args:
        config: settings that maps are loaded with.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._ready: dict[tuple[str, str], list[KnownMap]] = {}
        self._lock = threading.Lock()

    @property
    def config(self) -> Config:
        """Settings that maps are loaded with."""
        return self._config

    def load(self, path: str) -> KnownMap:
        """Load a map; blocks, so do not call it in an event loop.

        Raises:
            MapError: as `load_known_map`.
        """
        return load_known_map(Path(path), self._config)

    def offer(self, known: KnownMap) -> None:
        """Keep a loaded map for one `take`, even if its file changes before."""
        with self._lock:
            self._ready.setdefault((known.path, known.sha256), []).append(known)

    def take(self, path: str, sha256: str) -> KnownMap:
        """Return a map; load it if none is ready, as in a replay.

        Raises:
            CheckpointError: it cannot be loaded, or its content changed.
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
    """A session's localization at its start.

    Attributes:
        stage: for the mapping thread.
        maps: passes other maps to it.
        saved: estimate that it continues from.
        map_sha256: fingerprint of its first map; empty without one.
    """

    stage: LocalizationStage
    maps: KnownMaps
    saved: PlanarGaussian | None = None
    map_sha256: str = ""


def begun(config: Config, saved: PlanarGaussian | None = None) -> LocalizationSession | None:
    """Start by the settings; None if localization is off. Blocks while it loads the map.

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
    """Start as a recorded session did; None if localization was off.

    Raises:
        ConfigError: the map cannot be used, or its content changed.
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
    """State of the stage, and the settings that maps are loaded with, as plain values."""

    stage: LocalizationStageState
    loaded_by: dict[str, Any]


def saved_state(localizing: LocalizationSession) -> bytes:
    """Return the state for `restored_session`; call it in the mapping thread."""
    loaded_by = msgspec.to_builtins(localizing.maps.config)
    return encode_state(_SavedState(localizing.stage.state(), loaded_by))


def restored_session(config: Config, data: bytes) -> LocalizationSession:
    """Restore localization from the state that `saved_state` returned.

    Args:
        config: the settings at that time.
        data: the state.

    Raises:
        CheckpointError: the bytes are damaged or of another format, or the map is missing.
    """
    state, loaded_by = decode_state(data, _SavedState)
    try:
        maps = KnownMaps(config_of(loaded_by, "the checkpoint"))
        known = maps.take(state.path, state.sha256) if state.sha256 else None
        stage = LocalizationStage(config, load=maps.take)
        stage.restore(state, known)
    except (ConfigError, MapError, ValueError, TypeError) as error:
        raise CheckpointError(f"localization cannot resume: {error}") from error
    return LocalizationSession(stage, maps)


def numbers_of(pose: PlanarGaussian | None) -> Numbers12 | None:
    """Return a pose as a recording holds it."""
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
