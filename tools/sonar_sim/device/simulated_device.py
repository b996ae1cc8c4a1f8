"""A sonar that simulates pings in real time while it is served."""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from oculus_driver.sound_speed import pressure_bar_at
from oculus_driver.virtual_sonar.device import FireRequest, Identity, VirtualDevice
from sonar_sim.capture import POWER_UP_S
from sonar_sim.device.fire_settings import PROCESSING_S, initial_request, listening_s, period_s
from sonar_sim.device.ping_generator import PingGenerator, TransmitState
from sonar_sim.effects.plan import AUTO
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.scene.scenario import Scenario

FIRST_ID = 1
STALE_S = 0.1
MAX_LEAD_S = 0.25
"""So far a live pose is predicted at most."""
SMOOTHED_PINGS = 3
"""Whose durations predict that of the next one."""


@dataclass(frozen=True, slots=True)
class _Ready:
    """A ping that waits for its last echo: its fire message and its time of sending."""

    demand: FireRequest
    message: bytes
    ping_id: int
    due_s: float


class SimulatedDevice(VirtualDevice):
    """Obeys fire messages with pings simulated at the pose of transmission.

    Rate, two-way travel time and this computer limit the ping period. If a simulation takes longer,
    the next ping is transmitted later, not sent late. On a live route a simulation begins only as
    long before the transmission as the last ones took: the pose is predicted over that time. Until
    a fire message arrives the sonar pings with the scenario's settings or is in standby.

    Args:
        scenario: scene, sonar and mounting.
        route: route of the vehicle.
        clock: seconds on the route.
        identity: identity of the sonar; the part number is that of the scenario's model.
        standby: send nothing until a fire message requests pings.
        seed: seed of speckle and noise.
        effects: as for `sonar_sim.Simulator`.
        ignored_fire_version: version of fire messages that are ignored.

    Attributes:
        on_ping: called in the event loop with each simulated message and the state at its
            transmission; None calls nobody.
        simulated: number of simulated pings.
        late: number of pings whose simulation took longer than their echoes.
    """

    def __init__(
        self,
        scenario: Scenario,
        route: Trajectory,
        clock: Callable[[], float],
        identity: Identity,
        *,
        standby: bool = False,
        seed: int = 0,
        effects: str = AUTO,
        ignored_fire_version: int | None = None,
    ) -> None:
        device_id = identity.device_id or 1
        self._maker = PingGenerator(
            scenario.scene,
            scenario.sonar,
            scenario.mounting,
            seed=seed,
            source_id=device_id & 0xFFFF,
            effects=effects,
        )
        super().__init__(identity, device_id, self._maker.part_number, ignored_fire_version)
        self._water = scenario.scene.water
        self._route = route
        self._clock = clock
        self._standby = standby
        self._first_demand = initial_request(scenario.sonar, scenario.ping_rate_hz)
        self._thread = ThreadPoolExecutor(1, "simulator")
        self._ready: _Ready | None = None
        self._transmit_s = 0.0  # earliest next ping, time on the route
        self._boot_s = -POWER_UP_S  # power-up, time on the route
        self._next_id = FIRST_ID
        self._took_s = 0.0  # of a simulation, lately
        self.on_ping: Callable[[bytes, TransmitState], None] | None = None
        self.simulated = 0
        self.late = 0
        self.temperature_c = self._water.temperature_c

    @property
    def pinging(self) -> bool:
        """Whether it transmits, by itself or on triggers."""
        silent = self._standby if self.request is None else self.request.standby
        return self.can_ping and not silent and not self.ended

    @property
    def ended(self) -> bool:
        """Whether the route has ended."""
        return self._clock() >= self._route.duration_s

    @property
    def next_is_ping(self) -> bool:
        """Return True: only pings are sent unprompted."""
        return True

    @property
    def seconds_since_boot(self) -> float:
        """Return the time of the sonar's clock."""
        return self._clock() - self._boot_s

    async def warm_up(self) -> None:
        """Simulate a ping that is never sent: the first one also prepares the scene."""
        await self._make(self._first_demand, self._state_at(0.0))

    async def look(self) -> None:
        """Simulate a ping now for `on_ping` alone; it is not sent."""
        await self._make(self.request or self._first_demand, self._state_at(self._clock()))

    async def prepare(self) -> None:
        """Simulate the next ping, then wait until its last echo would be back."""
        demand = self.request or self._first_demand
        ready = self._ready
        # A ping left from before a disconnect or standby is outdated.
        if ready is None or ready.demand != demand or self._clock() - ready.due_s > STALE_S:
            await self._simulate(demand)
        if self._ready is not None:
            await asyncio.sleep(self._ready.due_s - self._clock())

    def wait_ns(self) -> int:
        """Return 0: `prepare` has waited."""
        return 0

    def take(self) -> tuple[bytes, int | None]:
        """Return the ping that is ready, and its id.

        Raises:
            LookupError: none is ready.
        """
        ready, self._ready = self._ready, None
        if ready is None:
            raise LookupError("no ping is ready: await prepare() first")
        self.triggers = max(0, self.triggers - 1)
        return ready.message, ready.ping_id

    def restart(self) -> None:
        """Restart ids and device time; settings stay."""
        self._ready = None
        self._next_id = FIRST_ID
        self._boot_s = self._clock()

    def close(self) -> None:
        """Stop after the ping that is being simulated."""
        self._thread.shutdown(wait=True, cancel_futures=True)

    async def _simulate(self, demand: FireRequest) -> None:
        transmit_s = max(self._transmit_s, self._clock())
        sonar = self._maker.settings(demand)
        if self._route.live:
            lead_s = min(self._took_s, MAX_LEAD_S)
            await asyncio.sleep(transmit_s - lead_s - self._clock())
        when = self._state_at(transmit_s)
        message = await self._make(demand, when)
        due_s = transmit_s + listening_s(sonar, self._water) + PROCESSING_S
        self.simulated += 1
        self.late += self._clock() > due_s
        self._transmit_s = transmit_s + period_s(demand, sonar, self._water, len(message))
        self._next_id += 1
        depth_m = max(0.0, -float(when.map_T_base.position_m[2]))
        self.pressure_bar = pressure_bar_at(depth_m, self._water.salinity_ppt)
        self._ready = _Ready(demand, message, when.ping_id, due_s)

    async def _make(self, demand: FireRequest, when: TransmitState) -> bytes:
        loop = asyncio.get_running_loop()
        began_s = time.monotonic()
        message = await loop.run_in_executor(self._thread, self._maker.make, demand, when)
        self._took_s += (time.monotonic() - began_s - self._took_s) / SMOOTHED_PINGS
        if self.on_ping is not None:
            self.on_ping(message, when)
        return message

    def _state_at(self, transmit_s: float) -> TransmitState:
        return TransmitState(
            self._next_id,
            transmit_s - self._boot_s,
            transmit_s,
            self._route.pose(transmit_s),
            self._route.velocity_mps(transmit_s),
            self._route.turn_rates_rps(transmit_s),
        )
