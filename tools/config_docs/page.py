"""The generated documentation of settings.

docs/reference/configuration.md lists every setting, from the types; a section of library.md lists
the settings of compatible programs that have no effect.
"""

from collections.abc import Iterator
from itertools import groupby
from typing import Any, get_args

import msgspec

from mapperd.config.aliases import ALIASES, IGNORED, VALUE_ALIASES
from mapperd.config.amcl import CORRECTED
from mapperd.config.catalog import Parameter, hint_at, inner_parameters, parameters

__all__ = ["configuration_page", "library_page"]

HEAD = """\
<!-- Written by `python -m config_docs` from the types in mapperd/config. -->

# Configuration

Every setting is optional and has a default. Unknown keys, invalid values and duplicate keys are
errors that name the file and the place; `mapperd` exits with code 78.

```yaml
octree:
  voxel_resolution: 0.1 # m
mounting:
  orientation: { pitch: 30 } # degrees
```

## Where settings come from

The first of these that sets a setting wins, for each setting separately (a list is one value):

1. the file of `--config`
2. the file that the variable `MAPPERD_CONFIG` names
3. `/etc/mapperd/conf.d/*.yaml`, the last name first, and `/etc/mapperd/mapperd.yaml`
4. `$XDG_CONFIG_HOME/mapperd/conf.d/*.yaml` and `mapperd.yaml` there, by default in `~/.config`
5. the defaults below

An error in any file is an error, even if a higher file overrides the setting. Rules about several
settings apply to the result. Settings that were removed since an earlier version are ignored, and
`mapperd` names all of them in one line.

`mapperctl params` prints the settings of these files, with `--origin` the file that set each, with
`--json` everything known about them. `config/` holds files to start from; `config/schema.json` is
the JSON Schema for editors.

## Changes while running

Settings marked *live* may change while the program runs, by `mapperctl`, telemetry or a viewer. All
values are checked, alone and together; then the change takes effect between two pings, as a whole.
If any value is invalid nothing changes, and the answer has a reason for every setting.

SIGHUP reads the files again and overrides changes made since. Settings that need a restart are
named and keep their value.

## All settings

The interval of a number is in the unit that follows: `[` and `]` include the limit, `(` and `)`
exclude it.

"""

AMCL = """\
## Names of the AMCL node

`amcl` has the parameters of Beluga AMCL with their defaults, except these, which its
documentation has wrong. `pf_z` keeps its 0.99, a quantile, not a probability.

| setting | documented | here | what is wrong |
|---|---|---|---|
"""

ALSO = """
Names of other releases of the node and of Nav2 are accepted too; a setting given under two names
is an error.

| name elsewhere | setting |
|---|---|
"""

BEGIN = "<!-- settings without effect: begin; written by `python -m config_docs` -->\n"
END = "<!-- settings without effect: end -->\n"


def configuration_page() -> str:
    """The page as it should be in docs/."""
    sections = groupby(parameters().values(), lambda one: one.name.partition(".")[0])
    body = "".join("\n".join(_section(name, list(found))) + "\n\n" for name, found in sections)
    return HEAD + body + _amcl()


def library_page(page: str) -> str:
    """Return docs/reference/library.md with its list of settings without effect renewed."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    ignored = "".join(f"- `{name}`: {why}\n" for name, why in IGNORED.items())
    return f"{before}{BEGIN}\n{ignored}\n{END}{after}"


def _amcl() -> str:
    corrected = "".join(
        f"| `amcl.{name}` | {was} | {_default(parameters()[f'amcl.{name}'])} | {why} |\n"
        for name, (was, why) in CORRECTED.items()
    )
    names = "".join(f"| `{other}` | `{name}` |\n" for other, name in ALIASES.items())
    values = "".join(
        f"| `{name}: {other}` | `{name}: {value}` |\n"
        for name, known in VALUE_ALIASES.items()
        for other, value in known.items()
    )
    return AMCL + corrected + ALSO + names + values


def _section(name: str, found: list[Parameter]) -> Iterator[str]:
    yield f"### {name}"
    yield ""
    yield _first_line(hint_at(f"$.{name}"))
    yield ""
    yield "| setting | default | allowed | live | meaning |"
    yield "|---|---|---|---|---|"
    for parameter in found:
        yield _row(parameter)
        yield from map(_row, inner_parameters(parameter))


def _row(parameter: Parameter) -> str:
    live = "yes" if parameter.dynamic else ""
    allowed = _interval(parameter.annotation) or parameter.allowed
    return (
        f"| `{parameter.name}` | {_default(parameter)} | {allowed} | {live} "
        f"| {parameter.description} |"
    )


def _interval(annotation: Any) -> str:  # noqa: ANN401 an annotation
    """Return the interval of a number and its unit, "" for another type."""
    base, meta = get_args(annotation)
    if base not in (int, float):
        return ""
    low = f"[{meta.ge:g}" if meta.gt is None else f"({meta.gt:g}"
    high = f"{meta.le:g}]" if meta.lt is None else f"{meta.lt:g})"
    kind = "integer" if base is int else ""
    return " ".join(filter(None, (kind, f"{low}, {high}", meta.extra_json_schema["x-unit"])))


def _default(parameter: Parameter) -> str:
    value = parameter.default
    if value is msgspec.UNSET:
        return "required"
    if inner_parameters(parameter):
        return "nothing" if value is None else f"{len(value)}, as below"
    if value == "":
        return "nothing"
    return (
        f"`{msgspec.json.encode(value).decode()}`" if not isinstance(value, str) else f"`{value}`"
    )


def _first_line(section: type) -> str:
    return (section.__doc__ or "").partition("\n")[0]
