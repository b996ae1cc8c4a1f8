"""A fake study, importable here and in the processes that measure."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from studies.accuracy_cost import study
from studies.accuracy_cost.study import Study


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[Study]:
    """The only study there is."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setattr(study, "MODULES", {"fake": "fake_study"})
    yield importlib.import_module("fake_study").STUDY
    del sys.modules["fake_study"]
