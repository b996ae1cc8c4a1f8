"""The map on two lines: the client ends up with it, whatever they do."""

import numpy as np
import pytest

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.priority_queue import NEAR_M
from mapperd.server.source_protocol import FIRST, SECOND
from mapperd.server.subscription import MAX_MESSAGES
from mapperd.wire.blocks import decode_blocks
from mapperd.wire.messages import Blocks, Interest
from tests.mapperd.server.told import SECOND_NS, Client, expected, scatter, source_of
from tests.mapperd.server.two_lines import AnyLuck, TwoLines


def begun(voxels: int = 300, reach_m: float = 3.0) -> tuple[SonarMap, TwoLines]:
    """A client with two lines that has had its first message, so that both may be told on."""
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 1, voxels, reach_m)
    source = source_of(sonar_map)
    lines = TwoLines(source, Interest())
    lines.has_second = True
    source.look(SECOND_NS)
    lines.tell(FIRST, 1)
    lines.deliver(FIRST, 1)
    return sonar_map, lines


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "interest",
    [Interest(), Interest(radius_m=2.0), Interest(level=1, detail="counts")],
    ids=["all", "radius", "coarse"],
)
def test_the_client_has_the_map_whatever_its_lines_do(interest: Interest, seed: int) -> None:
    sonar_map = SonarMap(Config())
    source = source_of(sonar_map)
    lines = AnyLuck(source, interest, seed)
    completes = 0
    for _ in range(300):
        lines.act()
        if interest.radius_m == 0 and lines.client.mirror.complete == sonar_map.core.revision:
            completes += 1
            assert lines.client.holds() == expected(sonar_map.core, source.facts(), interest)
    source.look(2 * SECOND_NS)
    lines.hear_all()
    assert lines.is_complete
    if interest.radius_m == 0:
        assert completes > 0
        assert lines.client.holds() == expected(sonar_map.core, source.facts(), interest)
    else:
        alone = Client(source, interest)
        alone.hear(position_m=lines.place)
        assert alone.holds().items() <= lines.client.holds().items()  # just outside may stay


def test_only_what_is_near_is_told_again() -> None:
    sonar_map, lines = begun(4000, reach_m=30.0)
    lines.tell(FIRST, 10_000)
    told = lines.client.view.left
    assert told == 0
    lines.client.view.tell_again(FIRST, lines.place)
    lines.tell(SECOND, 10_000)
    told_again = [one for one, _ in lines.way[SECOND] if isinstance(one, Blocks)]
    keys = np.concatenate([decode_blocks(one.body, counts=False).keys for one in told_again])
    low_m = keys * 8 * lines.source.facts().resolution_m
    away_m = np.linalg.norm(
        np.clip(0.0, low_m, low_m + 8 * lines.source.facts().resolution_m), axis=1
    )
    assert len(keys) > 50
    assert away_m.max() <= NEAR_M
    lines.hear_all()
    assert lines.client.holds() == expected(sonar_map.core, lines.source.facts(), Interest())


def test_complete_is_not_said_while_the_other_line_has_something_under_way() -> None:
    sonar_map, lines = begun()
    lines.tell(FIRST, 1)
    lines.tell(SECOND, 10_000)
    lines.deliver(SECOND, 10_000)
    assert lines.client.mirror.complete is None
    lines.deliver(FIRST, 1)
    lines.tell(SECOND, 10)
    lines.deliver(SECOND, 10)
    assert lines.client.mirror.complete == sonar_map.core.revision
    assert lines.is_complete


def test_complete_is_said_once_more_after_what_was_told_again() -> None:
    _, lines = begun()
    lines.tell(FIRST, 10_000)
    lines.client.view.tell_again(FIRST, lines.place)
    lines.tell(SECOND, 10_000)
    for line in (FIRST, SECOND):
        lines.deliver(line, 10_000)
    assert not lines.is_complete  # nobody knew that the first line had all
    lines.tell(SECOND, 10_000)
    lines.deliver(SECOND, 10_000)
    assert lines.is_complete


@pytest.mark.parametrize("lost", [True, False])
@pytest.mark.parametrize("how", ["change", "reset"])
def test_what_was_under_way_before_a_reset_is_not_told_again(how: str, *, lost: bool) -> None:
    """Blocks have other numbers afterwards, which there may be none of yet."""
    sonar_map, lines = begun()
    lines.tell(SECOND, 10_000)
    if how == "change":
        lines.client.view.change(Interest(level=3))
    else:
        lines.source._begin_anew()
    lines.client.view.tell_again(SECOND, lines.place)
    if lost:
        lines.lose_second()
    lines.source.look(SECOND_NS)
    lines.hear_all()
    interest = lines.client.mirror.interest
    assert lines.client.holds() == expected(sonar_map.core, lines.source.facts(), interest)


def test_complete_that_was_lost_with_the_second_line_is_said_again() -> None:
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 1, 300)
    source = source_of(sonar_map)
    lines = TwoLines(source, Interest(), most_bytes=1 << 20)
    lines.has_second = True
    source.look(SECOND_NS)
    lines.most_bytes = 600
    lines.tell(FIRST, 1)
    lines.deliver(FIRST, 1)
    lines.tell(SECOND, 1)
    lines.tell(FIRST, 10_000)  # it may not say that this is all
    lines.deliver(FIRST, 10_000)
    lines.deliver(SECOND, 1)
    assert not lines.is_complete
    lines.tell(SECOND, 1)
    lines.lose_second()
    lines.tell(FIRST, 1)
    lines.deliver(FIRST, 1)
    assert lines.is_complete


def test_what_was_read_before_a_reset_is_not_told_after_it() -> None:
    """Clients that are told the same share what was read, and pass over what is of before."""
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 1, 300)
    source = source_of(sonar_map)
    other, lines = Client(source), TwoLines(source, Interest(), most_bytes=1 << 20)
    source.look(SECOND_NS)
    other.hear(position_m=lines.place)
    lines.client.view.restart()
    lines.hear_all()
    assert lines.client.resets == 1
    assert lines.client.holds() == expected(sonar_map.core, source.facts(), Interest())


@pytest.mark.slow
def test_a_second_line_of_which_too_much_is_unknown_has_all_told_anew() -> None:
    sonar_map = SonarMap(Config())
    scatter(sonar_map, 1, 200)
    source = source_of(sonar_map)
    lines = TwoLines(source, Interest())
    lines.has_second = True
    source.look(SECOND_NS)
    lines.tell(FIRST, 100)
    lines.deliver(FIRST, 100)
    for n in range(MAX_MESSAGES + 2):
        sonar_map.core.set_log_odds(np.array([[0.05, 0.05, 0.05]]), np.array([n % 8 - 4.0]))
        source.look(SECOND_NS)
        lines.tell(SECOND, 1)
    lines.lose_second()
    lines.hear_all()
    assert lines.client.resets == 1
    assert lines.client.holds() == expected(sonar_map.core, source.facts(), Interest())
