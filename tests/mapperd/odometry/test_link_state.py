import re

from mapperd.odometry.links import LinkPhase, LinkState

S = 1_000_000_000


def test_a_link_names_what_it_does_and_since_when() -> None:
    link = LinkState("TCP dvl:16171", connects=True)
    link.opening(1 * S)
    link.opened(2 * S)
    assert (link.status.phase, link.overdue_ns) == (LinkPhase.WAITING, 7 * S)
    link.received(10, 3 * S)
    link.received(5, 4 * S)
    status = link.status
    assert (status.phase, status.since_ns, status.bytes_received) == ("receiving", 3 * S, 15)
    assert status.time_in_phase_s(5 * S) == 2.0
    assert link.tick(9 * S - 1) is False
    assert link.tick(9 * S) is False
    assert link.status.phase == "silent"
    assert re.search(r"\b5 s\b.*TCP dvl:16171", link.status.reason)
    link.received(1, 10 * S)
    assert link.status.phase == "receiving"
    link.tick(15 * S)
    assert not link.tick(25 * S - 1)
    assert link.tick(25 * S)  # no word for 15 s: the connection is dead, whatever TCP thinks


def test_a_port_that_only_listens_is_silent_for_ever() -> None:
    link = LinkState("UDP 127.0.0.1:1", connects=False)
    link.opened(0)
    link.tick(5 * S)
    assert (link.status.phase, link.overdue_ns) == ("silent", None)
    assert not link.tick(10_000 * S)


def test_pauses_grow_and_start_again_once_bytes_came() -> None:
    link = LinkState("x", connects=True)
    assert [link.lost("refused", 0) for _ in range(5)] == [
        S // 2,
        1 * S,
        2 * S,
        5 * S,
        5 * S,
    ]
    link.opened(10 * S)
    link.received(1, 10 * S)
    assert link.lost("reset", 11 * S) == 11 * S + S // 2
    assert (link.status.losses, link.status.opened, link.status.reason) == (6, 1, "reset")
