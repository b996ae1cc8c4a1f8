"""Every setting is read somewhere: none is accepted and then forgotten."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from mapperd.config.aliases import RESTORE
from mapperd.config.catalog import inner_parameters, parameters

ROOT = Path(__file__).resolve().parents[3]
READERS = ("mapperd", "oculus_driver", "tools/mapper_survey")


def names_read(path: Path) -> Iterator[str]:
    """Attributes that a module reads; as a prefix with `*` where the name is put together."""
    own = path.is_relative_to(ROOT / "mapperd" / "config")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            check = own and isinstance(node.value, ast.Name) and node.value.id == "self"
            if not check:  # a section that checks its own fields does not use them
                yield node.attr
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "getattr":
            name = node.args[1]
            if isinstance(name, ast.JoinedStr) and isinstance(name.values[0], ast.Constant):
                yield f"{ast.literal_eval(name.values[0])}*"


@pytest.mark.slow
def test_every_setting_is_read_somewhere() -> None:
    paths = [path for folder in READERS for path in (ROOT / folder).rglob("*.py")]
    read = {name for path in paths for name in names_read(path)}
    settings = [
        one.name
        for parameter in parameters().values()
        for one in (parameter, *inner_parameters(parameter))
    ]
    fields = {name: name.rpartition(".")[2] for name in settings}
    unread = [
        name
        for name, field in fields.items()
        if name != RESTORE and field not in read and f"{field.rstrip('0123456789')}*" not in read
    ]
    assert unread == []
