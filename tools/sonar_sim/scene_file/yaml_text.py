"""YAML without its traps: no aliases, no tags, no key twice, no word that is secretly a number."""

import math
import re
from pathlib import Path

import yaml

from sonar_sim.errors import SceneError

MOST_BYTES = 1 << 20
MAX_DEPTH = 20


class _Loader(yaml.SafeLoader):
    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse what makes a small file huge, or not what it looks like."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            raise SceneError(f"line {line}: aliases and tags are not taken")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise SceneError(f"line {line}: nested deeper than {MAX_DEPTH}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_twice(node)
        return node


def _finite(loader: _Loader, node: yaml.ScalarNode) -> float:
    """Read a number; nothing in a scene is infinite, and NaN passes through every limit."""
    number = float(loader.construct_yaml_float(node))
    if not math.isfinite(number):
        line = node.start_mark.line + 1
        raise SceneError(f"line {line}: {node.value[:60]} is not a finite number")
    return number


_Loader.add_constructor("tag:yaml.org,2002:float", _finite)


def _refuse_twice(node: yaml.MappingNode) -> None:
    names: set[str] = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise SceneError(f"line {key.start_mark.line + 1}: a key must be a name")
        if key.value in names:
            raise SceneError(f"line {key.start_mark.line + 1}: {key.value[:60]} is set twice")
        names.add(key.value)


# All that an unquoted word may be besides text: YAML 1.1 knows more (no, 1:30, 010, 2001-01-01),
# and does not know 1e-3.
_Loader.yaml_implicit_resolvers = {}
for _kind, _pattern, _first in (
    ("bool", r"true|false", "tf"),
    ("null", r"~|null|", ["~", "n", ""]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?[0-9]+[eE][-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?\.inf|\.nan", "-+."),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_kind}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )


def read_tree(path: Path) -> object:
    """Read a file's one document into plain dicts, lists and scalars.

    Raises:
        SceneError: it cannot be read or is not YAML as we take it; names file and line.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MOST_BYTES:
        raise SceneError(f"{path}: larger than {MOST_BYTES >> 20} MiB, not a scene")
    try:
        return yaml.load(data.decode("utf-8-sig"), _Loader)  # noqa: S506 a subclass of the safe one
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise SceneError(f"{path}: {where}not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = (str(error).splitlines() or ["cannot be read"])[0]
        raise SceneError(f"{path}: not YAML: {line}") from error
