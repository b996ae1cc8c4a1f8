import subprocess
import sys
from collections import Counter
from typing import get_args

import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.odometry import FormatName, FormatSettings
from mapperd.errors import ConfigError
from mapperd.odometry.decoder import MAX_NAMES, DecoderCounters
from mapperd.odometry.formats import check_levelling, make_decoder

NAMES: tuple[FormatName, ...] = get_args(FormatName)


@pytest.mark.parametrize("name", NAMES)
def test_every_format_has_its_decoder(name: FormatName) -> None:
    decoder = make_decoder(FormatSettings(format=name))
    list(decoder.feed(b"\xc1hello\r\n\0", None))
    decoder.restart()
    assert decoder.counters.bytes_total == 9
    assert decoder.counters.rejects.total() + decoder.counters.bytes_skipped > 0


@pytest.mark.parametrize(("name", "library"), [("mavlink", "pymavlink"), ("nmea", "pynmea2")])
def test_missing_library_is_one_line_that_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, name: FormatName, library: str
) -> None:
    for module in [m for m in sys.modules if m.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    for module in ("mavlink", "mavlink_frames", "nmea"):
        monkeypatch.delitem(sys.modules, f"mapperd.odometry.{module}", raising=False)
    monkeypatch.setattr(sys, "meta_path", [_Missing(library), *sys.meta_path])
    with pytest.raises(
        ConfigError, match=rf"{library} cannot be imported.* `{name}`: .*pip install"
    ) as caught:
        make_decoder(FormatSettings(format=name))
    assert "\n" not in str(caught.value)


class _Missing:
    """Stands before all finders: that library is not installed."""

    def __init__(self, library: str) -> None:
        self._library = library

    def find_spec(self, name: str, *_: object) -> None:
        if name.partition(".")[0] == self._library:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_library_of_a_format_is_loaded_only_for_it() -> None:
    code = (
        "import sys; from mapperd.odometry.formats import make_decoder; "
        "from mapperd.config.odometry import FormatSettings as S; "
        "make_decoder(S(format='water_linked_json')); "
        "print([m for m in sys.modules if m in ('pymavlink', 'pynmea2')])"
    )
    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_names_from_the_wire_do_not_fill_the_memory() -> None:
    counters = DecoderCounters()
    for number in range(10 * MAX_NAMES):
        counters.heard(str(number), 1)
        counters.ignore(str(number))
    for counter in (counters.messages, counters.ignored):
        assert isinstance(counter, Counter)
        assert len(counter) == MAX_NAMES + 1
        assert counter.total() == 10 * MAX_NAMES


LEVELLING = "world_init: {{enabled: {}}}\nodometry: {{sources: [{}], owners: {{attitude: {}}}}}"
DVL, PILOT = "{name: dvl, format: water_linked_json}", "{name: ap, format: mavlink}"


@pytest.mark.parametrize(
    ("sources", "owner", "able"),
    [
        (PILOT, "''", True),
        (f"{DVL}, {PILOT}", "''", True),
        (f"{DVL}, {PILOT}", "ap", True),
        (f"{DVL}, {PILOT}", "dvl", False),
        (DVL, "''", False),
        ("{name: gps, format: nmea}", "gps", False),
        (PILOT, "none", False),
    ],
)
def test_levelling_without_accelerations_is_refused(
    sources: str, owner: str, *, able: bool
) -> None:
    check_levelling(config_from_text(LEVELLING.format("false", sources, owner)))
    config = config_from_text(LEVELLING.format("true", sources, owner))
    if able:
        check_levelling(config)
        return
    with pytest.raises(
        ConfigError, match=r"world_init\.enabled: no source .* formats that do: nat"
    ):
        check_levelling(config)
