"""The pure parts: rates, tokens."""

from mapperd.wire.auth import FailureLimiter, TokenBucket, is_proof, proof_of, site_of


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
