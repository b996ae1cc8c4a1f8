"""Secrets: in files of their own, never among the settings."""

from collections.abc import Mapping
from pathlib import Path

from mapperd.errors import ConfigError

__all__ = ["read_secret"]

MOST_BYTES = 4096


def read_secret(
    setting: str, path: str, credential: str, environment: Mapping[str, str]
) -> str | None:
    """Read a secret: the first line of a file.

    Args:
        setting: name of the setting that says the path, for messages.
        path: the file; "" takes systemd's credential where there is one.
        credential: its name among systemd's.
        environment: says where systemd has put credentials.

    Returns:
        None where neither is there.

    Raises:
        ConfigError: the file cannot be read, or holds no secret.
    """
    folder = environment.get("CREDENTIALS_DIRECTORY", "")
    place = Path(path) if path else Path(folder, credential)
    if not path and (not folder or not place.exists()):
        return None
    try:
        with place.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        line = data.decode().split("\n", 1)[0].strip("\r")
    except OSError as error:
        raise ConfigError(f"{setting}: {place}: {error.strerror}", f"$.{setting}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{setting}: {place}: is no text", f"$.{setting}") from error
    if not line or len(data) > MOST_BYTES:
        what = "is empty" if not line else f"is longer than {MOST_BYTES} bytes"
        raise ConfigError(f"{setting}: {place}: {what}", f"$.{setting}")
    return line
