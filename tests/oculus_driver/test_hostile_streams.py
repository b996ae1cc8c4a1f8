"""Streams made to waste time or memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from oculus_driver import framing
from oculus_driver.stream import StreamParser
from oculus_driver.wire import HEADER, MAX_MESSAGE_SIZE, MIB


def header(message_id: int, payload: int) -> bytes:
    return HEADER.pack({"message_id": message_id, "payload_size": payload})


HOSTILE = {
    "headers that claim 16 MiB": header(0x23, 16 * MIB),
    "headers of full pings": header(0x22, 16 * MIB),
    "headers of empty dummies": header(0xFF, 0),
    "headers with unknown ids": header(0x77, MIB),
    "bare magic": b"SO",
    "half headers": header(0x23, 16 * MIB)[:12],
    "zeros": bytes(16),
}


@pytest.mark.parametrize("pattern", HOSTILE.values(), ids=HOSTILE.keys())
@pytest.mark.parametrize("lead", [b"", b"x"])
def test_hostile_streams_take_linear_work(
    pattern: bytes, lead: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0
    judge = framing.FrameChecker.check

    def counting(self: framing.FrameChecker, *arguments: Any) -> framing.FrameResult:
        nonlocal calls
        calls += 1
        return judge(self, *arguments)

    monkeypatch.setattr(framing.FrameChecker, "check", counting)
    stream = lead + pattern * (MIB // 2 // len(pattern))
    parser = StreamParser()
    chunks = range(0, len(stream), 4096)
    for start in chunks:
        parser.feed(stream[start : start + 4096])
    parser.finish()
    assert parser.counters.bytes_total == len(stream)
    assert calls <= len(stream) // 8 + 2 * len(chunks)


def test_memory_is_bounded_by_one_message() -> None:
    block = (header(0x23, 16 * MIB) + bytes(4080)) * 256
    parser = StreamParser()
    for _ in range(40):
        parser.feed(block)
        assert parser.pending_bytes <= MAX_MESSAGE_SIZE + HEADER.size + len(block)
    parser.finish()
    assert parser.counters.bytes_rejected == 40 * len(block)


@pytest.mark.parametrize("seed", range(5))
def test_noise_gives_no_messages(seed: int) -> None:
    parser = StreamParser()
    assert parser.feed(np.random.default_rng(seed).bytes(300_000)) + parser.finish() == []
    assert parser.counters.bytes_rejected == 300_000
