"""A dive mapped and told to one client, in simulated time."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from bench.pings import Pings

from mapperd.mapping.sonar_map import SonarMap
from studies.accuracy_cost.streaming.clients import Client, PlainClient, StreamClient
from studies.accuracy_cost.streaming.dives import PING_S, Plan, position_of
from studies.accuracy_cost.streaming.figures import NEAR_M, Moment, moment, summary
from studies.accuracy_cost.streaming.link import Link
from studies.accuracy_cost.streaming.settings import Told
from studies.accuracy_cost.streaming.told import PlainTeller, StreamTeller, Teller
from studies.accuracy_cost.streaming.truth import Ages, Blocks

__all__ = ["watched"]

STEP_S = 0.02
LOOK_S = 0.07
"""After a ping: pings and looks do not wait for each other."""


@dataclass
class _Watch:
    """One client, its link, and what is judged."""

    teller: Teller
    client: Client
    link: Link
    ages: Ages
    made_s: deque[float] = field(default_factory=deque)
    changed: int = 0
    seen: dict[bytes, np.ndarray] = field(default_factory=dict)

    def step(self, now_s: float, position_m: np.ndarray) -> None:
        """Send what there is room for, and read what arrives."""
        for message, made_s in self.teller.messages(now_s, position_m):
            self.link.carry(message)
            self.made_s.append(made_s)
        for message in self.link.step(now_s):
            self.ages.told(self.client.take(message), self.made_s.popleft())

    def count(self, blocks: Blocks) -> None:
        """Voxels that are otherwise than at the ping before."""
        for key, units in zip(blocks.keys, blocks.units, strict=True):
            name = key.tobytes()
            before = self.seen.get(name)
            self.changed += int(np.count_nonzero(units if before is None else units != before))
            self.seen[name] = units.copy()


def watched(pings: Pings, plan: Plan, told: Told) -> dict[str, float]:
    """The figures of all columns."""
    sonar_map = SonarMap(told.config)
    for number in range(plan.joins):
        _map(sonar_map, pings, number)
    watch = _joined(sonar_map, plan, told)
    moments: list[Moment] = []
    ages_s: list[tuple[float, float]] = []
    cpu_s: list[float] = []
    joined_s = plan.joins * PING_S
    now_s, next_look_s = joined_s, joined_s + LOOK_S
    for number in range(plan.joins, plan.pings):
        position_m = position_of(pings, number)
        _map(sonar_map, pings, number)
        blocks = Blocks(*sonar_map.core.blocks())
        watch.ages.changed(blocks, now_s)
        watch.count(blocks)
        until_s, before_s = (number + 1) * PING_S, watch.teller.cpu_s
        while now_s < until_s - STEP_S / 2:
            if now_s >= next_look_s:
                watch.teller.look(now_s, position_m)
                next_look_s += 1 / told.config.stream.rate
            watch.step(now_s, position_m)
            now_s += STEP_S
            ages_s.append(watch.ages.oldest_s(now_s, position_m, NEAR_M))
        cpu_s.append(watch.teller.cpu_s - before_s)
        if number % plan.judged_every == 0:
            moments.append(moment(blocks, watch.client, watch.teller.facts(), position_m))
    return summary(moments, ages_s) | {
        "bytes_per_voxel": watch.link.carried / max(watch.changed, 1),
        "kb_per_s": watch.link.carried / (now_s - joined_s) / 1e3,
        "cpu_ms_per_ping": 1e3 * float(np.mean(cpu_s)),
        "cpu_median_ms": 1e3 * float(np.median(cpu_s)),
        "cpu_p95_ms": 1e3 * float(np.quantile(cpu_s, 0.95)),
        "memory_mb": watch.teller.memory_bytes / 1e6,
    }


def _joined(sonar_map: SonarMap, plan: Plan, told: Told) -> _Watch:
    teller: Teller
    client: Client
    if told.is_plain:
        teller, client = PlainTeller(sonar_map), PlainClient()
    else:
        stream = told.config.stream
        step, limit = stream.log_odds_step, stream.bytes_per_s
        teller = StreamTeller(sonar_map, told.interest, step, limit)
        client = StreamClient(teller.facts(), told.interest)
    link = Link(plan.link, teller.pacer)
    return _Watch(teller, client, link, Ages(teller.facts(), told.interest))


def _map(sonar_map: SonarMap, pings: Pings, number: int) -> None:
    sonar_map.integrate(pings.echo(number, first_returns_only=False), pings.map_T_sonar[number])
