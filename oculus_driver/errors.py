"""Exceptions of the driver, and `Reject`, the record of a message that was not decoded.

OculusError
├── ProtocolError    bytes or values do not fit the wire format
│   └── EncodeError  a value does not fit the message
├── RecordingError   a file cannot be opened, read or written as a recording
│   ├── RecordingMissingError     it does not exist or cannot be opened
│   └── RecordingUnwritableError  it exists already or cannot be written
├── ExtraMissingError  a library is missing that an extra installs
├── DiscoveryError   the port of the status broadcasts cannot be opened
├── OutsideLimitsError  a value is outside the validity of a formula
├── SettingsError    the settings are invalid
└── LinkError        the sonar is unreachable or does not answer; a retry may help

Parsers never raise these for received bytes: malformed bytes are counted and reported.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import sys
from dataclasses import dataclass


class OculusError(Exception):
    """Base class of all exceptions that this package raises on purpose."""


class ProtocolError(OculusError):
    """Bytes or values do not fit the wire format."""


class EncodeError(ProtocolError, ValueError):
    """A value does not fit the message."""


class SettingsError(OculusError, ValueError):
    """The settings are invalid or not supported by the sonar. The caller must correct them."""


class LinkError(OculusError):
    """The sonar is unreachable or does not answer. A retry may help."""


class RecordingError(OculusError):
    """A file cannot be opened, read or written as a recording.

    The message is one line: the file, the problem, and what to do.
    """


class RecordingMissingError(RecordingError):
    """A file does not exist or cannot be opened."""


class RecordingUnwritableError(RecordingError):
    """A file exists already or cannot be written."""


class ExtraMissingError(OculusError):
    """A library is missing that an extra installs."""


class DiscoveryError(OculusError):
    """The port of the status broadcasts cannot be opened.

    The message is one line: the port, the problem, and what to do.
    """


class OutsideLimitsError(OculusError, ValueError):
    """A value is outside the validity of a formula. The message names the value and its limits."""


@dataclass(frozen=True, slots=True)
class Reject:
    """A message that was not decoded.

    Attributes:
        reason: machine-readable reason: not_a_ping, unknown_version, short_message, empty,
            out_of_bounds, size_mismatch, bad_resolution, bad_data_size.
        detail: one sentence for the user.
        offset: offset of the message in its stream, bytes.
        ping_id: id of the ping, None if it cannot be read. A ping with an id was received, so it
            does not count as lost.
    """

    reason: str
    detail: str
    offset: int
    ping_id: int | None = None


def missing_extra(library: str, extra: str) -> str:
    """Return one line that names a missing library and the command that installs its extra.

    The command names the extra's libraries, so it works in every folder, for an installation from
    a checkout and from a wheel.

    Args:
        library: name for people.
        extra: name in the optional dependencies of mapperd, or of the driver where it is alone.
    """
    from importlib import metadata  # noqa: PLC0415 slow to import, rarely needed

    requirements: list[str] = []  # where the source tree is on the path
    for distribution in ("mapperd", "oculus-driver"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            requirements = requirements or metadata.requires(distribution) or []
    marker = re.compile(rf"""\bextra\s*==\s*['"]{re.escape(extra)}['"]""")
    parts = (requirement.partition(";") for requirement in requirements)
    libraries = [shlex.quote(name.strip()) for name, _, rule in parts if marker.search(rule)]
    words = [shlex.quote(sys.executable or "python3"), "-m pip install"]
    words += libraries or [f"'.[{extra}]'"]
    return f"{library} cannot be imported; to install the extra `{extra}`: {' '.join(words)}"
