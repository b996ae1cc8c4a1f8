"""Clients that do anything, of a map to which anything happens, end with their part of it."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.map_index import distances_m
from mapperd.wire.messages import Interest, MapBox
from tests.mapperd.server.sent_state import SECOND_NS, Client, expected, scatter, source_of
from tests.mapperd.store.dive import CONFIG, integrate

STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("scatter"), st.integers(0, 1000)),
        st.tuples(st.just("ping"), st.integers(0, 100)),
        st.tuples(st.just("look"), st.integers(0, 3)),
        st.tuples(st.just("hear"), st.integers(1, 4000)),
        st.tuples(st.just("reconnect"), st.integers(0, 1)),
        st.tuples(st.just("change"), st.integers(0, 11)),
        st.tuples(st.just("move"), st.integers(0, 5)),
        st.tuples(st.just("clear"), st.just(0)),
    ),
    max_size=25,
)
INTERESTS = [
    Interest(level=level, detail=detail, radius_m=radius_m)  # type: ignore[arg-type]
    for level, detail in ((0, "log_odds"), (1, "counts"), (2, "classes"), (3, "log_odds"))
    for radius_m in (0.0, 1.5)
] + [
    Interest(level=level, radius_m=radius_m, box=MapBox((-2.0, -1.0, -4.0), (1.0, 2.0, 0.5)))
    for level in (0, 1)
    for radius_m in (0.0, 1.5)
]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 11), STEPS)
def test_whatever_happens_a_client_ends_with_its_part_of_the_map(
    first: int, steps: list[tuple[str, int]]
) -> None:
    sonar_map = SonarMap(CONFIG)
    source = source_of(sonar_map)
    client = Client(source, INTERESTS[first])
    now_ns, position = SECOND_NS, (0.0, 0.0, 0.0)
    for what, number in steps:
        if what == "scatter":
            scatter(sonar_map, number, 40, reach_m=2.5)
        elif what == "ping":
            integrate(sonar_map, number)
        elif what == "look":
            now_ns += number * 40 * SECOND_NS
            source.look(now_ns, position)
        elif what == "hear":
            client.hear(number, 2, position)
        elif what == "reconnect":
            client.reconnect(source)
        elif what == "change":
            client.interest = INTERESTS[number]
            client.view.change(client.interest)
        elif what == "move":
            position = (0.7 * number - 2.0, 0.3, -1.0)
        else:
            sonar_map.core.clear()
    source.look(now_ns + 100 * SECOND_NS, position)
    client.hear(position_m=position)
    _assert_same_part(client, sonar_map, position)
    assert client.mirror.complete == sonar_map.core.revision


def _assert_same_part(
    client: Client, sonar_map: SonarMap, position: tuple[float, float, float]
) -> None:
    interest, holds = client.interest, client.holds()
    whole = expected(sonar_map.core, client.mirror.info, interest)
    assert all(whole.get(key) == sent for key, sent in holds.items())
    keys = np.array(list(whole), np.int32).reshape(-1, 3)
    edge_m = client.mirror.cell_m * 8
    wanted = np.ones(len(keys), bool)
    if interest.box is not None:
        low = keys * edge_m
        wanted &= np.all((low < interest.box.high_m) & (low + edge_m > interest.box.low_m), axis=1)
    allowed = wanted.copy()
    if interest.radius_m:
        away = distances_m(keys, edge_m, position)
        wanted &= away <= interest.radius_m * 0.98
        allowed &= away <= interest.radius_m * 1.12
    names = [tuple(key) for key in keys.tolist()]
    assert {name for name, is_so in zip(names, wanted, strict=True) if is_so} <= holds.keys()
    assert holds.keys() <= {name for name, is_so in zip(names, allowed, strict=True) if is_so}
