"""Who may come in: a first request that says hello, and proves to know the token where one is."""

from dataclasses import dataclass

from mapperd.wire.auth import FailureLimiter, is_proof
from mapperd.wire.control_messages import VERSION, Ask, Fault, Hello

__all__ = ["Newcomer", "doubt", "objection"]


@dataclass(frozen=True, slots=True)
class Newcomer:
    """Who stands at a door.

    Attributes:
        peer: its address.
        challenge: that it was greeted with.
        token: of the door; None where file permissions decided.
    """

    peer: str
    challenge: str
    token: bytes | None


def objection(
    newcomer: Newcomer, hello: Ask | Fault, failures: FailureLimiter, now_s: float
) -> Fault | None:
    """Why a newcomer may not come in; None where it may.

    Args:
        newcomer: who it is.
        hello: its first request.
        failures: is told of a wrong proof.
        now_s: monotonic.
    """
    if isinstance(hello, Fault):
        return hello
    if not isinstance(hello, Hello):
        return Fault("bad_request", "the first request is hello")
    if hello.version != VERSION:
        known = {"versions": [VERSION]}
        return Fault("bad_version", f"version {hello.version} is not spoken", known)
    return doubt(newcomer, hello.proof, failures, now_s)


def doubt(newcomer: Newcomer, proof: str, failures: FailureLimiter, now_s: float) -> Fault | None:
    """Whether it does not know the token, or may not try again yet; None where it may come in."""
    token = newcomer.token
    if token is None:
        return None
    wait_s = failures.wait_s(newcomer.peer, now_s)
    if wait_s > 0:  # even with the right one: else trying would go on
        said = f"too many wrong tokens; wait {wait_s:.0f} s"
        return Fault("locked_out", said, {"wait_s": wait_s})
    if is_proof(proof, token, newcomer.challenge):
        return None
    failures.failed(newcomer.peer, now_s)
    return Fault("wrong_token", "the token is not the one of this daemon")
