"""Inputs that the fuzzers found keep what the fuzzers check."""

import pytest

from tests.fuzz import fuzz_map_stream, fuzz_stream
from tests.fuzz.cases import read_cases

STREAM = read_cases("stream")
MAP_STREAM = read_cases("map_stream")


@pytest.mark.parametrize("data", STREAM.values(), ids=STREAM)
def test_stream(data: bytes) -> None:
    fuzz_stream.one_input(data)


@pytest.mark.parametrize("data", MAP_STREAM.values(), ids=MAP_STREAM)
def test_map_stream(data: bytes) -> None:
    fuzz_map_stream.one_input(data)
