"""What can go wrong, as a tree that says who is at fault.

OculusError
├── ProtocolError    bytes or values that do not fit the wire format
│   └── EncodeError  a value that has no place in the message it was given for
├── RecordingError   a file that cannot be opened, read or written as a recording
├── DiscoveryError   the port of the status broadcasts cannot be listened on
└── OutsideLimitsError  a value for which a formula does not hold
├── SettingsError    the sonar is asked for something that it cannot be asked for
├── LinkError        the sonar cannot be reached, or does not answer: may be better later
└── RecordingError   a file that cannot be opened, read or written as a recording

Parsers never raise these on bytes from outside: bad bytes are data, counted and reported.
"""

from __future__ import annotations

from dataclasses import dataclass


class OculusError(Exception):
    """Root of everything that this package raises on purpose."""


class ProtocolError(OculusError):
    """Bytes or values do not fit the wire format."""


class EncodeError(ProtocolError, ValueError):
    """A value has no place in the message that it was given for."""


class SettingsError(OculusError, ValueError):
    """The sonar is asked for something that it cannot be asked for: the caller's to correct."""


class LinkError(OculusError):
    """The sonar cannot be reached or does not answer; trying again later may help."""


class RecordingError(OculusError):
    """A file cannot be opened, read or written as a recording.

    The text is one line: what is wrong, with which file, and what to do.
    """


class DiscoveryError(OculusError):
    """The port of the status broadcasts cannot be listened on.

    The text is one line: which port, why not, and what to do.
    """


class OutsideLimitsError(OculusError, ValueError):
    """A value for which a formula does not hold. The text names the value and its limits."""


@dataclass(frozen=True, slots=True)
class Reject:
    """A message that was not decoded.

    Attributes:
        reason: a name to count by: not_a_ping, unknown_version, short_message, empty,
            out_of_bounds, size_mismatch, bad_resolution, bad_data_size.
        detail: a sentence for a person.
        offset: position of the message in its stream.
        ping_id: of the ping, None where it cannot be read. Such a ping came; it is not lost.
    """

    reason: str
    detail: str
    offset: int
    ping_id: int | None = None
