"""docs/reference/configuration.md: every setting, from the types."""

from collections.abc import Iterator
from itertools import groupby

import msgspec

from mapperd.config.aliases import ALIASES, IGNORED, VALUE_ALIASES
from mapperd.config.amcl import CORRECTED
from mapperd.config.catalog import Parameter, hint_at, inner_parameters, parameters

__all__ = ["configuration_page"]

HEAD = """\
<!-- Written by `python -m config_docs` from the types in mapperd/config*.py. -->

# Configuration

Settings are YAML: sections, and settings in them. Nothing has to be said; what is not said has its
default. A word that is not known, a value that is not allowed and a key that is said twice are
errors that name the file and the place; `mapperd` then ends with exit code 78.

```yaml
octree:
  voxel_resolution: 0.1 # m
mounting:
  orientation: { pitch: 30 } # degrees
```

## Where settings come from

From the highest of these that says a setting, each setting on its own (lists as a whole):

1. the file of `--config`
2. the file that the variable `MAPPERD_CONFIG` names
3. `/etc/mapperd/conf.d/*.yaml`, the last name first, and `/etc/mapperd/mapperd.yaml`
4. `$XDG_CONFIG_HOME/mapperd/conf.d/*.yaml` and `mapperd.yaml` there, by default in `~/.config`
5. the defaults below

A mistake in a file is an error even where a higher one says the setting anew. Rules about several
settings hold for all files together.

Files written for an earlier version load: settings that were removed are ignored, and `mapperd`
names all of them in one line.

`mapperctl params` prints the settings that these files give, `--origin` also which file said each,
`--json` everything there is to know about them. `config/` holds files to start from;
`config/schema.json` is the JSON Schema, for editors that check while one types.

## Changes while running

Settings marked *live* may change while the program runs. Every change takes the same way, whoever
asks: all values are checked, alone and together; what cannot follow is asked; then the change holds
from one ping to the next, as a whole. If anything speaks against it nothing changes, and the answer
has a reason for every setting. A setting that nothing running follows is refused, never
taken and forgotten.

SIGHUP has the files read again. What they say then holds, also where a setting was changed by
another way since; settings that need a restart are named and left.

## All settings

"""

AMCL = """\
## Localization under the names of the published AMCL node

The parameters of the node are in `amcl`, with their defaults but for these, which its document
has wrong. `pf_z` keeps its 0.99, which looks like a probability and is a quantile.

| setting | published | here | what is wrong |
|---|---|---|---|
"""

ALSO = """
Other releases of the node and Nav2 have other names for some settings. Files and changes may say
them; a setting given under two names is an error.

| name elsewhere | setting |
|---|---|
"""

TAIL = """\
## Ignored settings

Files of the programs that mapperd replaces may hold these settings. They have no effect, whatever
their value; `mapperd` names them in one line of its log.

{ignored}

All other parameters of the published mapper are here under their names and with their defaults,
except `outofcore.map_path`, whose default named a folder of its developers, and
`sonar.vertical_aperture`, whose 20 degrees map worse and slower
([accuracy-cost.md](../reports/accuracy-cost.md#mapping)).
"""


def configuration_page() -> str:
    """The page as it should be in docs/."""
    sections = groupby(parameters().values(), lambda one: one.name.partition(".")[0])
    body = "".join("\n".join(_section(name, list(found))) + "\n\n" for name, found in sections)
    ignored = "\n".join(f"- `{name}`" for name in IGNORED)
    return HEAD + body + _amcl() + TAIL.format(ignored=ignored)


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
    return AMCL + corrected + ALSO + names + values + "\n"


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
    allowed = parameter.allowed.replace("|", "\\|")
    return (
        f"| `{parameter.name}` | {_default(parameter)} | {allowed} | {live} "
        f"| {parameter.description} |"
    )


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
