"""Makes decoders by the settings; libraries of a format are imported only when needed."""

from importlib.util import find_spec

from mapperd.config.odometry import NOBODY, FormatSettings, OdometryFusionConfig, parse_address
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, missing_extra
from mapperd.odometry.decoder import Decoder, LineDecoder, ReadLine
from mapperd.odometry.native import MAX_LINE_BYTES as JSON_BYTES
from mapperd.odometry.native import NativeDecoder, NativeSerialDecoder, read_native_json
from mapperd.odometry.water_linked import MAX_JSON_LINE_BYTES as DVL_JSON_BYTES
from mapperd.odometry.water_linked import MAX_SERIAL_LINE_BYTES as DVL_SERIAL_BYTES
from mapperd.odometry.water_linked import read_water_linked_json, read_water_linked_serial

__all__ = ["check_levelling", "check_libraries", "make_decoder"]

_LINES: dict[str, tuple[ReadLine, int]] = {
    "native_json": (read_native_json, JSON_BYTES),
    "water_linked_json": (read_water_linked_json, DVL_JSON_BYTES),
    "water_linked_serial": (read_water_linked_serial, DVL_SERIAL_BYTES),
}


def make_decoder(settings: FormatSettings, *, datagrams: bool = False) -> Decoder:
    """Make the decoder of one link.

    Args:
        settings: the format, and data that its bytes lack.
        datagrams: bytes arrive in whole datagrams, not as a stream.

    Raises:
        ConfigError: the format needs a library that is not installed.
    """
    if settings.format == "native":
        return NativeDecoder()
    if settings.format == "native_serial":
        return NativeSerialDecoder()
    if settings.format == "nmea":
        return _nmea(datagrams=datagrams)
    if settings.format == "mavlink":
        return _mavlink(settings, datagrams=datagrams)
    read, max_line_bytes = _LINES[settings.format]
    return LineDecoder(read, max_line_bytes, datagrams=datagrams)


def check_libraries(settings: OdometryFusionConfig, *, decoding: bool) -> None:
    """Check at start that the libraries of all sources are installed.

    Args:
        settings: the sources.
        decoding: the bytes are decoded, not only recorded.

    Raises:
        ConfigError: one is missing.
    """
    for source in settings.sources:
        if decoding:
            make_decoder(source)
        if parse_address(source.link).kind == "serial" and find_spec("serial") is None:
            text = f"serial links: {missing_extra('pyserial', 'serial')}"
            raise ConfigError(text, "$.odometry.sources")


WITH_ACCELERATION = ("native", "native_json", "native_serial", "mavlink")


def check_levelling(config: Config) -> None:
    """Check that a source measures the gravity that `world_init` needs.

    Raises:
        ConfigError: levelling is on, and the source of the attitude sends no accelerations.
    """
    owner = config.odometry.owners.attitude
    able = owner != NOBODY and any(
        source.format in WITH_ACCELERATION and owner in ("", source.name)
        for source in config.odometry.sources
    )
    if config.world_init.enabled and not able:
        path = "$.world_init.enabled"
        raise ConfigError(
            f"{path}: no source of the attitude sends accelerations, so nothing would ever be "
            f"mapped; formats that do: {', '.join(WITH_ACCELERATION)}",
            path,
        )


def _nmea(*, datagrams: bool) -> Decoder:
    try:
        from mapperd.odometry.nmea import MAX_LINE_BYTES, NmeaReader  # noqa: PLC0415 an extra
    except ModuleNotFoundError as error:
        raise _explained(error, "pynmea2", "nmea") from error
    return LineDecoder(NmeaReader(), MAX_LINE_BYTES, datagrams=datagrams)


def _mavlink(settings: FormatSettings, *, datagrams: bool) -> Decoder:
    try:
        from mapperd.odometry.mavlink import MavlinkDecoder  # noqa: PLC0415 an extra
    except ModuleNotFoundError as error:
        raise _explained(error, "pymavlink", "mavlink") from error
    return MavlinkDecoder(settings, datagrams=datagrams)


def _explained(error: ModuleNotFoundError, library: str, extra: str) -> Exception:
    if (error.name or "").partition(".")[0] != library:
        return error
    return ConfigError(f"format {extra}: {missing_extra(library, extra)}")
