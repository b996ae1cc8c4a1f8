"""YAML to settings: total, bounded, and with one line that says what is wrong and what is not."""

import difflib
import re
import textwrap
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import yaml

from mapperd.config import Config
from mapperd.errors import ConfigError
from mapperd.yaml_strict import YamlProblem, parse_yaml

__all__ = ["MAX_FILE_BYTES", "config_from_text", "load_config", "rule_text"]

MAX_FILE_BYTES = 256 * 1024
"""A settings file is a few kilobytes; more is a mistake or an attack."""


def load_config(path: Path) -> Config:
    """Read settings from a YAML file.

    Raises:
        ConfigError: the file cannot be read, or something in it is wrong; one line that names
            the file, the place, what is wrong and what is allowed.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would keep us waiting
            kind = "a directory" if path.is_dir() else "no regular file"
            raise ConfigError(f"{path}: cannot be read: is {kind}")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES // 1024} KiB, not a settings file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start})") from error
    return config_from_text(text, str(path))


def config_from_text(text: str, name: str = "config") -> Config:
    """Read settings from YAML text; an empty document or section means the defaults.

    Args:
        text: the document.
        name: what to call it in messages.

    Raises:
        ConfigError: as `load_config`.
    """
    try:
        tree = parse_yaml(text)
    except YamlProblem as problem:
        raise ConfigError(f"{name}: {problem}") from problem
    if tree is None:
        return Config()
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: $: a mapping of sections was expected")
    for section in Config.__struct_fields__:
        if section in tree and tree[section] is None:
            tree[section] = {}
    try:
        return msgspec.convert(tree, Config)
    except msgspec.ValidationError as error:
        raise _explained(str(error), tree, name) from error


def _explained(message: str, tree: dict[Any, Any], name: str) -> ConfigError:
    """Turn msgspec's sentence into ours: file, place, what is wrong, what is allowed."""
    match = re.fullmatch(r"(.*?)(?: - at (?:`key` in )?`(\$[^`]*)`)?", message, re.DOTALL)
    what, path = (match[1], match[2] or "$") if match else (message, "$")
    if unknown := re.search(r"unknown field `(.*)`", what, re.DOTALL):
        return _unknown_field(unknown[1], path, name)
    allowed = rule_text(path)
    if allowed is None:
        return ConfigError(f"{name}: {path}: {_section_problem(what, path)}", path)
    value = _shown(_value_at(tree, path))
    return ConfigError(f"{name}: {path}: {value} is not allowed; allowed: {allowed}", path)


def _section_problem(what: str, path: str) -> str:
    """A rule about several fields as it stands, or ours for a section of the wrong kind."""
    if not what.startswith("Expected"):
        return what
    if what == "Expected `str`":
        return "a key is not a name"
    names = ", ".join(getattr(_type_at(path), "__struct_fields__", ()))
    return f"a section was expected; allowed: {names}"


def _unknown_field(field: str, path: str, name: str) -> ConfigError:
    section = _type_at(path)
    known = list(getattr(section, "__struct_fields__", ()))
    near = difflib.get_close_matches(field, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"allowed: {', '.join(known)}"
    where = f"{path}.{field[:60]}"
    return ConfigError(f"{name}: {where}: there is no such setting; {hint}", where)


def rule_text(path: str) -> str | None:
    """What a setting allows, for people: "a number >= 0.001 and <= 100 (m)".

    Args:
        path: `$.octree.voxel_resolution`.

    Returns:
        None where the path names no single setting.
    """
    hint = _type_at(path)
    if get_origin(hint) is None:
        return None
    base, meta = get_args(hint)[0], hint.__metadata__[0]
    if base is bool:
        return "true or false"
    if base is str:
        return str(meta.extra["unit"])
    if get_origin(base) is not None:
        return " or ".join(str(choice) for choice in get_args(base))
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    limits = [f"{s} {getattr(meta, k):g}" for k, s in signs.items() if getattr(meta, k) is not None]
    kind = "a whole number" if base is int else "a number"
    unit = meta.extra["unit"]
    return f"{kind} {' and '.join(limits)}" + (f" ({unit})" if unit else "")


def _type_at(path: str) -> Any:  # noqa: ANN401 a type or an annotation
    """The annotation of a setting, or the class of a section."""
    hint: Any = Config
    for part in path.split(".")[1:]:
        hint = get_type_hints(hint, include_extras=True).get(part, object)
    return hint


def _value_at(tree: Any, path: str) -> Any:  # noqa: ANN401 whatever stands in the file
    for part in path.split(".")[1:]:
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def _shown(value: object) -> str:
    """The value as its writer would know it, in one short line."""
    text = "nothing" if value is None else " ".join(yaml.safe_dump(value, width=10**6).split())
    return textwrap.shorten(text.removesuffix("..."), 60, placeholder="...")
