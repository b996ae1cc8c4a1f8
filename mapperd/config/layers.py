"""Layers of settings files, and which file each value comes from."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from mapperd.config.aliases import tree_updated
from mapperd.config.catalog import parameters
from mapperd.config.loader import config_of, holds_nodes, parse_yaml, read_tree
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, os_reason

__all__ = [
    "DEFAULT",
    "Layered",
    "load_files",
    "load_settings",
    "settings_files",
    "text_with",
    "user_folder",
]

DEFAULT = "default"
"""Origin of a setting that no file names."""

SYSTEM = Path("/etc/mapperd")
VARIABLE = "MAPPERD_CONFIG"


@dataclass(frozen=True, slots=True)
class Layered:
    """Settings and where they come from.

    Attributes:
        config: the settings.
        origins: absolute path of the file that names a setting, `octree.voxel_resolution`.
        notice: settings of an earlier version in the files, and those of the other rule, in one
            line; empty where there are none.
    """

    config: Config = field(default_factory=Config)
    origins: Mapping[str, str] = field(default_factory=dict)
    notice: str = ""

    def origin_of(self, name: str) -> str:
        """The file that sets a value, or `DEFAULT`."""
        return self.origins.get(name, DEFAULT)


def load_settings(
    given: Sequence[Path], environ: Mapping[str, str], system: Path = SYSTEM
) -> Layered:
    """Settings of a program: files of its command line on top of those of its surroundings.

    Args:
        given: files of the command line, the last one on top.
        environ: the process's variables.
        system: the machine's folder of settings.

    Raises:
        ConfigError: as `load_files`.
    """
    return load_files(settings_files(given, environ, system))


def settings_files(
    given: Sequence[Path], environ: Mapping[str, str], system: Path = SYSTEM
) -> list[Path]:
    """The files that count, lowest first; folders need not be there, named files must.

    The user's folder ($XDG_CONFIG_HOME/mapperd), the machine's, the file that $MAPPERD_CONFIG
    names, and those of the command line. Of a folder: mapperd.yaml, then conf.d/*.yaml by name.

    Raises:
        ConfigError: a folder cannot be looked into.
    """
    named = environ.get(VARIABLE, "")
    return [
        *_files_of(user_folder(environ)),
        *_files_of(system),
        *([Path(named)] if named else []),
        *given,
    ]


def load_files(files: Sequence[Path]) -> Layered:
    """Read files on top of each other; each setting is the one of the last file that names it.

    Raises:
        ConfigError: a file cannot be read, or something in it is wrong, even if a later file
            overrides it; or the files together violate a rule about several settings.
    """
    merged: dict[str, Any] = {}
    origins: dict[str, str] = {}
    outdated: list[str] = []
    for path in files:
        tree, phrases = tree_updated(read_tree(path))
        if phrases:
            outdated.append(f"{path}: {', '.join(phrases)}")
        for name, value in _leaves(tree, ""):
            _put(merged, name, value)
            origins[name] = str(path.absolute())  # a client may have another working folder
    try:
        config = config_of(merged, "settings")
    except ConfigError as error:
        raise ConfigError(_named(error, origins), error.path) from error
    unused = [name for name in origins if _is_unused(name, config)]
    if unused:
        outdated.append(
            f"without effect by mapping.rule {config.mapping.rule}: {', '.join(unused)}"
        )
    return Layered(config, origins, "; ".join(outdated))


OF_IWLO = (
    "iwlo.",
    "adaptive.",
    "mapping.occupied_threshold",
    "mapping.free_threshold",
    "mapping.aggregation",
    "mapping.integrator",
    "mapping.detail",
    "mapping.angular_cone_width",
    "filtering.noise_factor",
)
"""Beginnings of the names of settings that the arc rule does not use."""


def _is_unused(name: str, config: Config) -> bool:
    """Return whether a setting belongs to the other rule."""
    return name.startswith(OF_IWLO if config.mapping.rule == "arc" else "arc.")


def _leaves(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if f"{prefix}{key}" in parameters():
            yield f"{prefix}{key}", value
        else:
            yield from _leaves(value, f"{prefix}{key}.")


def _put(tree: dict[str, Any], name: str, value: object) -> None:
    *sections, leaf = name.split(".")
    for section in sections:
        tree = tree.setdefault(section, {})
    tree[leaf] = value


def _named(error: ConfigError, origins: Mapping[str, str]) -> str:
    """The message about several settings, with the files that set them."""
    section = error.path.removeprefix("$").removeprefix(".")
    involved = [file for name, file in origins.items() if name.startswith(section)]
    files = " with ".join(dict.fromkeys(involved)) or "settings"
    return f"{files}: {str(error).removeprefix('settings: ')}"


def user_folder(environ: Mapping[str, str]) -> Path | None:
    """Where a user keeps settings by the XDG base directory rules: relative paths do not count."""
    home = environ.get("HOME", "")
    for base, more in ((environ.get("XDG_CONFIG_HOME", ""), ""), (home, ".config")):
        if Path(base).is_absolute():
            return Path(base) / more / "mapperd"
    return None


def _files_of(folder: Path | None) -> list[Path]:
    if folder is None:
        return []
    first, more = folder / "mapperd.yaml", folder / "conf.d"
    try:
        fragments = sorted(path for path in more.iterdir() if path.suffix == ".yaml")
    except (FileNotFoundError, NotADirectoryError):
        fragments = []
    except OSError as error:
        raise ConfigError(f"{more}: cannot be read: {os_reason(error)}") from error
    try:
        first.stat()
    except (FileNotFoundError, NotADirectoryError):
        return fragments
    except OSError:
        pass  # it exists; reading it reports the error
    return [first, *fragments]


def text_with(text: str, name: str, value: object) -> str:
    """Return the text of a settings file with another value of one setting.

    Comments and all other values stay as they are.

    Args:
        text: of a valid settings file; may be empty.
        name: of the setting, `octree.voxel_resolution`.
        value: as plain values.

    Raises:
        ConfigError: the value stands in the file in a form that cannot be replaced.
    """
    if holds_nodes(parse_yaml(text)):
        raise ConfigError(f"{name}: the file holds parameters of ROS 2 nodes: edit it there", name)
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    keys = name.split(".")
    inside: yaml.MappingNode | None = None
    while keys and isinstance(node, yaml.MappingNode):
        inside = node
        found = {key.value: at for key, at in node.value}.get(keys[0])
        if found is None:
            break
        node = found
        keys.pop(0)
    shown = json.dumps(value)
    if not keys and node is not None:
        return _replaced(text, node, shown, name)
    if node is not inside and node is not None and node.start_mark.index < node.end_mark.index:
        raise ConfigError(f"{name}: its section has another form in the file", name)
    first, *rest = keys
    entry = f"{first}: {''.join(f'{{ {key}: ' for key in rest)}{shown}{' }' * len(rest)}"
    if inside is None or node is None or len(keys) == len(name.split(".")):
        return f"{text.rstrip()}\n{entry}\n".lstrip()
    at = inside.start_mark
    if inside.flow_style:
        return f"{text[: at.index + 1]} {entry},{text[at.index + 1 :]}"
    return f"{text[: at.index]}{entry}\n{' ' * at.column}{text[at.index :]}"


def _replaced(text: str, node: yaml.Node, shown: str, name: str) -> str:
    is_block = isinstance(node, yaml.CollectionNode) and not node.flow_style
    if is_block or getattr(node, "style", None) in ("|", ">"):
        raise ConfigError(f"{name}: its value takes several lines in the file: edit it there", name)
    begin, end = node.start_mark.index, node.end_mark.index
    gap = " " if text[begin - 1 : begin] == ":" else ""
    return f"{text[:begin]}{gap}{shown}{text[end:]}"
