"""The settings in force, and the one way to change them while the program runs.

Commands, the broker and signals all change settings through `apply` or `reload`. A change holds
as a whole or not at all, and only if everything that it concerns follows it. Differences between
two trees of settings, and settings as plain values, are here too.
"""

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from mapperd.config.aliases import ALIASES, IGNORED, change_renamed, restored_changes
from mapperd.config.catalog import Parameter, parameters, value_of
from mapperd.config.layers import DEFAULT, Layered
from mapperd.config.loader import check_value, config_of
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from oculus_driver.command_line import did_you_mean

__all__ = [
    "Applied",
    "ConfigStore",
    "Refused",
    "Reloaded",
    "SettingChange",
    "changes_between",
    "chosen",
    "facts_of",
    "occupied_above",
    "with_values",
]


def changes_between(before: Config, after: Config) -> dict[str, Any]:
    """Plain values, by name, of the settings that are other than before."""
    return {
        name: value
        for name in parameters()
        if (value := value_of(after, name)) != value_of(before, name)
    }


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """Settings of which some have other values, by name or by another name of the setting.

    Raises:
        ConfigError: they are not allowed.
    """
    tree = msgspec.to_builtins(config)
    for name, value in values.items():
        *sections, leaf = ALIASES.get(name, name).split(".")
        section = tree
        for part in sections:
            section = section[part]
        section[leaf] = value
    return config_of(tree, "")


def occupied_above(config: Config, probability: float) -> dict[str, float]:
    """Changes by which voxels above a probability are occupied, by whichever rule."""
    return {
        f"{section}.{limit}_threshold": value
        for section, free in (
            ("mapping", config.mapping.free_threshold),
            ("arc", config.arc.free_threshold),
        )
        for limit, value in (("occupied", probability), ("free", min(free, probability)))
    }


def facts_of(
    config: Config, origin_of: Callable[[str], str], names: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Value, default, unit, limits, origin and meaning of settings, by name.

    Args:
        config: the settings.
        origin_of: returns where a value comes from.
        names: settings or sections; none is all.
    """
    return {
        parameter.name: {
            "value": value_of(config, parameter.name),
            "default": parameter.default,
            "unit": parameter.unit,
            "allowed": parameter.allowed,
            "dynamic": parameter.dynamic,
            "origin": origin_of(parameter.name),
            "description": parameter.description,
        }
        for parameter in chosen(names)
    }


def chosen(names: Sequence[str]) -> list[Parameter]:
    """The settings of these names and sections, in the order of the tree; of none, all."""
    return [
        parameter
        for name, parameter in parameters().items()
        if not names or any(name == one or name.startswith(f"{one}.") for one in names)
    ]


RESTART = "cannot change while running; needs a restart"
UNFOLLOWED = "nothing that runs follows this setting; needs a restart"


@dataclass(frozen=True, slots=True)
class SettingChange:
    """One setting that changed, with plain values."""

    name: str
    before: Any
    after: Any


@dataclass(frozen=True, slots=True)
class Applied:
    """What was asked holds from now on.

    Attributes:
        origin: who asked.
        changes: what is other than before.
    """

    origin: str
    changes: tuple[SettingChange, ...]


@dataclass(frozen=True, slots=True)
class Refused:
    """Nothing changed.

    Attributes:
        origin: who asked.
        reasons: by setting, or by section for rules about several; never empty.
    """

    origin: str
    reasons: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Result of reloading the settings.

    Attributes:
        result: of those that may change while running.
        waiting: those that are otherwise in the files but need a restart.
    """

    result: Applied | Refused
    waiting: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Follower:
    names: tuple[str, ...]
    check: Callable[[Config], None]
    take: Callable[[Config], None]

    def follows(self, name: str) -> bool:
        return any(name == mine or name.startswith(f"{mine}.") for mine in self.names)


class ConfigStore:
    """Holds one immutable tree at a time; any thread may read it or ask for changes.

    Args:
        layered: the settings at the start.
    """

    def __init__(self, layered: Layered) -> None:
        self._current = self._start = layered.config
        self._origins = dict(layered.origins)
        self._followers: list[_Follower] = []
        self._lock = threading.Lock()
        self._settled: set[str] = set()

    @property
    def current(self) -> Config:
        """The settings in force."""
        return self._current

    def origin_of(self, name: str) -> str:
        """Where a value comes from: a file, a command, or the defaults."""
        return self._origins.get(name, DEFAULT)

    def follow(
        self,
        names: Collection[str],
        take: Callable[[Config], None],
        check: Callable[[Config], None] = lambda _: None,
    ) -> None:
        """Follow changes. A setting without a follower cannot change.

        Args:
            names: settings or sections.
            take: called with the new settings. If it raises `ConfigError`, the change is refused
                and every follower called so far, this one included, gets the old settings again.
            check: called first; raises `ConfigError` for settings that `take` would refuse.
        """
        self._followers.append(_Follower(tuple(names), check, take))

    def settle(self, name: str, value: object, origin: str) -> Config:
        """Set something before anything runs; reading the files again leaves it.

        Args:
            name: of a setting that may not change later.
            value: plain.
            origin: who knows it.

        Raises:
            ConfigError: the value is not allowed.
        """
        before = value_of(self._current, name)
        self._current = self._merged([SettingChange(name, before, value)])
        self._origins[name] = origin
        self._settled.add(name)
        return self._current

    def apply(self, changes: Mapping[str, object], origin: str) -> Applied | Refused:
        """Change settings, all or none.

        Args:
            changes: plain values by name, `filtering.intensity_threshold`; other names that a
                setting has are as good.
            origin: who asks.
        """
        try:
            changes = restored_changes(change_renamed(changes), self._start.amcl)
        except ConfigError as error:
            return Refused(origin, {_bare(error.path): _what(error)})
        with self._lock:
            reasons = self._objections(changes)
            if reasons:
                return Refused(origin, reasons)
            changed = self._differences(changes)
            if not changed:
                return Applied(origin, ())
            try:
                self._commit(self._merged(changed), [change.name for change in changed])
            except ConfigError as error:
                return Refused(origin, {_bare(error.path) or "settings": _what(error)})
            self._origins |= {change.name: origin for change in changed}
            return Applied(origin, tuple(changed))

    def reload(self, layered: Layered, origin: str) -> Reloaded:
        """Apply reloaded settings: the files override earlier changes.

        Changes that need a restart are reported and not applied; the rest is applied, all or none.

        Args:
            layered: the files' settings.
            origin: who asks.
        """
        other = {
            name: value
            for name in parameters()
            if (value := value_of(layered.config, name)) != value_of(self._current, name)
            and not (name in self._settled and layered.origin_of(name) == DEFAULT)
        }
        live = {name: value for name, value in other.items() if self._objection(name) is None}
        result = self.apply(live, origin)
        if isinstance(result, Applied):
            with self._lock:
                self._origins |= {name: layered.origin_of(name) for name in live}
        return Reloaded(result, tuple(name for name in other if name not in live))

    def _objections(self, changes: Mapping[str, object]) -> dict[str, str]:
        """Everything that speaks against a change, setting by setting."""
        reasons: dict[str, str] = {}
        for name, value in changes.items():
            if name not in parameters():
                reasons[name] = _unknown(name)
                continue
            try:
                check_value(value, f"$.{name}", "")
            except ConfigError as error:
                reasons[name] = _what(error)
                continue
            objection = self._objection(name)
            if objection is not None and value != value_of(self._current, name):
                reasons[name] = objection
        return reasons

    def _objection(self, name: str) -> str | None:
        if not parameters()[name].dynamic:
            return RESTART
        followed = any(follower.follows(name) for follower in self._followers)
        return None if followed else UNFOLLOWED

    def _differences(self, changes: Mapping[str, object]) -> list[SettingChange]:
        before = {name: value_of(self._current, name) for name in changes}
        return [
            SettingChange(name, before[name], value)
            for name, value in changes.items()
            if value != before[name]
        ]

    def _merged(self, changed: list[SettingChange]) -> Config:
        return with_values(self._current, {change.name: change.after for change in changed})

    def _commit(self, config: Config, names: list[str]) -> None:
        """Check with all followers, then apply to all; undo if one fails."""
        followers = [one for one in self._followers if any(map(one.follows, names))]
        for follower in followers:
            follower.check(config)
        old, self._current = self._current, config
        applied: list[_Follower] = []
        try:
            for follower in followers:
                applied.append(follower)
                follower.take(config)
        except BaseException:
            self._current = old
            for follower in reversed(applied):
                follower.take(old)
            raise


def _unknown(name: str) -> str:
    if name in IGNORED:
        return f"has no effect: {IGNORED[name]}"
    return f"there is no such setting{did_you_mean(name, parameters())}"


def _what(error: ConfigError) -> str:
    """The message without the place, which stands beside it."""
    return str(error).removeprefix(": ").removeprefix(f"{error.path}: ")


def _bare(path: str) -> str:
    return path.removeprefix("$").removeprefix(".")
