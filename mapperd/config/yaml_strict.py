"""YAML without its traps: no aliases, no duplicate keys, no depth, no tags, nothing silent."""

import re
from typing import Any

import yaml

__all__ = ["MAX_DEPTH", "YamlProblem", "parse_yaml"]

MAX_DEPTH = 16
"""Nesting beyond this is refused before it can exhaust the stack."""


class YamlProblem(ValueError):  # noqa: N818 it is always wrapped by the caller's error
    """The text is not YAML as we take it; the message is one line with the place."""


class _Loader(yaml.SafeLoader):
    """Safe loading that refuses what a settings file never needs."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse aliases (a bomb of them is small to write, huge to hold) and deep nesting."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise YamlProblem(
                f"{_place(event.start_mark)}: aliases (*{event.anchor}) are not taken"
            )
        if getattr(event, "tag", None) is not None:
            raise YamlProblem(f"{_place(event.start_mark)}: tags ({event.tag}) are not taken")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise YamlProblem(f"{_place(event.start_mark)}: nested deeper than {MAX_DEPTH}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:  # noqa: FBT001, FBT002 the base class's signature
        """Build a mapping; duplicate keys and merges are mistakes, not last-one-wins."""
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise YamlProblem(f"{_place(key.start_mark)}: a key must be a name")
            if key.value in seen:
                raise YamlProblem(f"{_place(key.start_mark)}: {key.value[:60]} is set twice")
            if key.tag == "tag:yaml.org,2002:merge":
                raise YamlProblem(f"{_place(key.start_mark)}: merge keys (<<) are not taken")
            seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


# What an unquoted word may be, else it is text. YAML 1.1 also reads 1:30 as 90, 1_0 as 10, 010 as
# 8, no as false and 2001-01-01 as a date, but 1e-3 as text.
_Loader.yaml_implicit_resolvers = {}
for _kind, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?[0-9]+[eE][-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", "-+."),
    ("merge", r"<<", "<"),  # to be refused by name
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_kind}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )


def parse_yaml(text: str) -> object:
    """Parse one YAML document into plain dicts, lists and scalars.

    Raises:
        YamlProblem: one line that says where and what.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506 a subclass of the safe loader
    except YamlProblem:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = _place(mark) if mark else "somewhere"
        raise YamlProblem(f"{where}: not YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = (str(error).splitlines() or ["cannot be read"])[0]
        raise YamlProblem(f"not YAML: {line}") from error


def _place(mark: Any) -> str:  # noqa: ANN401 the two kinds of mark have no common type
    return f"line {mark.line + 1}, column {mark.column + 1}"
