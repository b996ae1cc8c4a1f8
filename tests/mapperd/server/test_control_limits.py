"""The pure parts: lines, rates, tokens."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.events import EventLog, Severity
from mapperd.server.control_session import LineBuffer, LineTooLongError
from mapperd.server.dispatch import EventFeed
from mapperd.wire.auth import FailureLimiter, TokenBucket, is_proof, proof_of, site_of


@given(
    st.lists(st.binary(max_size=30).map(lambda data: data.replace(b"\n", b"").rstrip(b"\r"))),
    st.integers(1, 7),
)
def test_lines_come_out_however_they_are_cut(lines: list[bytes], step: int) -> None:
    data = b"".join(line + b"\n" for line in lines)
    buffer, found = LineBuffer(30), []
    for begin in range(0, len(data), step):
        buffer.feed(data[begin : begin + step])
        while (line := buffer.next_line()) is not None:
            found.append(line)
    assert found == lines
    assert len(buffer) == 0


@pytest.mark.parametrize("data", [b"x" * 31, b"x" * 31 + b"\n", b"ok\n" + b"x" * 31])
def test_line_that_is_too_long_is_noticed_before_its_end(data: bytes) -> None:
    buffer = LineBuffer(30)
    buffer.feed(data)
    if data.startswith(b"ok"):
        assert buffer.next_line() == b"ok"
    with pytest.raises(LineTooLongError, match="longer than 30 bytes"):
        buffer.next_line()


def test_line_as_long_as_allowed_is_taken() -> None:
    buffer = LineBuffer(30)
    buffer.feed(b"x" * 30)
    assert buffer.next_line() is None
    buffer.feed(b"\n")
    assert buffer.next_line() == b"x" * 30


def test_bucket_lets_a_few_through_at_once_and_then_its_rate() -> None:
    bucket = TokenBucket(2.0, 3)
    assert [bucket.take(10.0) for _ in range(5)] == [0.0, 0.0, 0.0, 0.5, 1.0]
    assert bucket.take(11.0) == 0.5
    assert bucket.wait_s(11.0) == 1.0
    assert not bucket.is_full(11.0)
    assert bucket.is_full(100.0)
    assert bucket.take(100.0) == 0.0
    assert bucket.take(0.0) == 0.0  # a clock that goes back gives nothing
    assert bucket.take(0.0) == 0.0
    assert bucket.take(0.0) == 0.5


def test_failures_lock_an_address_out_for_a_while() -> None:
    limiter = FailureLimiter(per_s=0.1, at_once=3)
    for _ in range(3):
        assert limiter.wait_s("10.0.0.1", 0.0) == 0.0
        limiter.failed("10.0.0.1", 0.0)
    assert limiter.wait_s("10.0.0.1", 0.0) == 10.0
    assert limiter.wait_s("10.0.0.2", 0.0) == 0.0
    assert limiter.wait_s("10.0.0.1", 10.0) == 0.0
    limiter.failed("10.0.0.1", 10.0)
    assert limiter.wait_s("10.0.0.1", 10.0) == 10.0


def test_memory_of_failures_is_bounded_and_the_oldest_goes_first() -> None:
    limiter = FailureLimiter(at_once=1, addresses=100)
    for number in range(10_000):
        limiter.failed(f"10.0.{number // 256}.{number % 256}", 0.0)
    assert len(limiter) == 100
    assert limiter.wait_s("10.0.39.15", 0.0) > 0  # the last one
    assert limiter.wait_s("10.0.0.0", 0.0) == 0


def test_one_customer_of_ipv6_has_one_memory() -> None:
    limiter = FailureLimiter(at_once=1)
    limiter.failed("2001:db8:1:2::1", 0.0)
    assert limiter.wait_s("2001:db8:1:2:ffff::9", 0.0) > 0
    assert limiter.wait_s("2001:db8:1:3::1", 0.0) == 0
    assert site_of("::ffff:10.0.0.1") == "10.0.0.1"
    assert site_of("fe80::1%eth0") == "fe80::/64"
    assert site_of("") == ""


def test_proof_is_an_hmac_that_anybody_can_make() -> None:
    # openssl: printf 'mapperd-control-1 c0ffee' | openssl dgst -sha256 -hmac sixteen-letters-x
    proof = proof_of(b"sixteen-letters-x", "c0ffee")
    assert proof == "c890d5619f46ad3575613f4022cfb97b140a7f164eb217f9afbf9a56cf758571"
    assert is_proof(proof, b"sixteen-letters-x", "c0ffee")
    for wrong in ("", proof[:-1], proof.upper(), "\udcff" * 64, "é" * 64):
        assert not is_proof(wrong, b"sixteen-letters-x", "c0ffee")
    assert not is_proof(proof, b"sixteen-letters-x", "c0ffef")


def test_feed_tells_all_in_order_and_says_when_there_is_more() -> None:
    log = EventLog(lambda: 0, kept=300)
    for number in range(500):
        log.add(Severity.INFO, "code", str(number))
    feed = EventFeed(log, 10)
    first, second = feed.take(), feed.take()
    assert (first["missed"], first["more"], second["missed"], second["more"]) == (
        190,
        True,
        0,
        False,
    )
    numbers = [event["number"] for told in (first, second) for event in told["events"]]
    assert numbers == list(range(201, 501))
    assert feed.take() == {"events": [], "missed": 0, "more": False}


def test_feed_of_a_daemon_that_was_started_anew_begins_at_its_end() -> None:
    log = EventLog(lambda: 0)
    feed = EventFeed(log, 9999)
    log.add(Severity.INFO, "code", "new")
    assert [event["text"] for event in feed.take()["events"]] == ["new"]
