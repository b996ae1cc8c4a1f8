"""A scene's file against its types; what is wrong is said with its place in the file."""

import difflib
import re
import textwrap
from pathlib import Path

import msgspec
import yaml

from sonar_sim.errors import SceneError
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.sections import Section
from sonar_sim.scene_file.yaml_text import read_tree


def read_scene_file(path: Path) -> schema.SceneFile:
    """Read and check a file; nothing is built yet.

    Raises:
        SceneError: one line that names the file, the place in it, and what is wrong.
    """
    tree = read_tree(path)
    if not isinstance(tree, dict):
        raise SceneError(f"{path}: $: a mapping of sections was expected")
    try:
        return msgspec.convert(tree, schema.SceneFile)
    except msgspec.ValidationError as error:
        raise SceneError(f"{path}: {_explained(str(error), tree)}") from error


def _explained(message: str, tree: object) -> str:
    match = re.fullmatch(r"(.*?)(?: - at (?:`key` in )?`(\$[^`]*)`)?", message, re.DOTALL)
    what, place = (match[1], match[2] or "$") if match else (message, "$")
    found = _at(tree, place)
    if unknown := re.search(r"unknown field `(.*)`", what, re.DOTALL):
        return f"{place}.{unknown[1][:60]}: there is no such setting{_hint(unknown[1], found)}"
    if "required field" in what or isinstance(found, (dict, list)):
        return f"{place}: {what}"
    return f"{place}: {_shown(found)} is not allowed: {what}"


def _hint(name: str, section: object) -> str:
    names = sorted(FIELD_NAMES - set(section if isinstance(section, dict) else ()))
    near = difflib.get_close_matches(name, names, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _at(tree: object, place: str) -> object:
    """What stands at a place such as `$.objects[3].shape`."""
    for key, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", place):
        if isinstance(tree, dict):
            tree = tree.get(key)
        elif isinstance(tree, list) and index and int(index) < len(tree):
            tree = tree[int(index)]
        else:
            return None
    return tree


def _shown(value: object) -> str:
    text = "nothing" if value is None else " ".join(yaml.safe_dump(value, width=10**6).split())
    return textwrap.shorten(text.removesuffix("..."), 60, placeholder="...")


FIELD_NAMES = {
    name
    for section in vars(schema).values()
    if isinstance(section, type) and issubclass(section, Section)
    for name in section.__struct_fields__
}
