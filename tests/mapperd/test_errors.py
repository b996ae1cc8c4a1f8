"""Errors of one process are read in another, as Dask's workers send them."""

import pickle

import pytest

from mapperd.api import OperationError
from mapperd.cli.mapperctl.connection import CtlError
from mapperd.client.validation import AskError, EndedError
from mapperd.errors import (
    CheckpointError,
    ConfigError,
    ExportError,
    LiveError,
    MapError,
    MapperdError,
    ReplayError,
    StoreError,
)
from mapperd.wire.framing import StreamError
from oculus_driver.command_line import ExitCode


@pytest.mark.parametrize(
    "error",
    [
        *(kind("bad") for kind in (MapperdError, LiveError, ReplayError, CheckpointError)),
        ExportError("bad"),
        ConfigError("bad", "$.octree"),
        MapError("bad", "out_of_range"),
        StoreError("bad", "damaged"),
        StreamError("bad", "too_long"),
        EndedError("bad", "wrong_token"),
        AskError("not_connected", "bad", {"a": 1}),
        CtlError("bad", ExitCode.TRY_AGAIN),
        OperationError("bad", "busy"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_of_another_process_is_the_same(error: MapperdError) -> None:
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 our own
    assert type(again) is type(error)
    assert (str(again), vars(again)) == (str(error), vars(error))
