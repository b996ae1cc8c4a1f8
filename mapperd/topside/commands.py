"""The commands of `mapperctl` that make files without a daemon."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from mapperd.config import Config
from mapperd.ctl.errors import CtlError, Exit, plain
from mapperd.errors import ConfigError, ExportError, MapperdError
from mapperd.geodesy import Origin
from mapperd.topside.converting import convert
from oculus_driver.errors import OculusError

__all__ = ["run"]


def run(said: argparse.Namespace, config: Config) -> Iterator[str]:
    """Do a command; yields what there is to print, as it comes.

    Args:
        said: the arguments.
        config: the settings.

    Raises:
        CtlError: it is not done.
        ConfigError: the settings do not allow it.
    """
    try:
        for line in _COMMANDS[said.command](said, config):
            yield plain(line)
    except ExportError as error:
        raise CtlError(str(error), Exit.CANNOT_WRITE) from error
    except ConfigError:
        raise
    except (MapperdError, OculusError) as error:
        raise CtlError(str(error), Exit.USAGE) from error


def _convert(said: argparse.Namespace, config: Config) -> Iterator[str]:
    return convert(said.source, said.file, config, _values(said, config), _origin(said))


def _values(said: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Settings that the arguments stand for."""
    least = said.min_probability
    if least is None:
        return {}
    free = min(config.mapping.free_threshold, least)
    return {"mapping.occupied_threshold": least, "mapping.free_threshold": free}


def _origin(said: argparse.Namespace) -> Origin | None:
    return None if said.origin is None else Origin.of_degrees(*said.origin)


_COMMANDS: Mapping[str, Callable[[argparse.Namespace, Config], Iterator[str]]] = MappingProxyType(
    {"convert": _convert}
)
