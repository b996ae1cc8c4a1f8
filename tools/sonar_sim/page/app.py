"""The page: serves a browser, draws, and hands keys on."""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oculus_driver.errors import missing_extra
from sonar_sim.device.ping_generator import TransmitState
from sonar_sim.device.server import ServedScenario
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import rotation_of
from sonar_sim.page.helm import KEYS, Helm
from sonar_sim.page.scene_view import PingPictures, SceneView, ping_of

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from viser import ClientHandle, ViserServer

MOVE_S = 0.1
PICTURE_S = 0.1
BEHIND_M = np.array([-4.5, 0.0, 2.6])
AHEAD_M = 3.0
"""The camera's place, and what it looks at before the vehicle."""
SETTLE_S = 5.0


def open_scene_page(host: str, port: int) -> "ViserServer":
    """Serve an empty page.

    Raises:
        SonarSimError: viser is missing, or the port is taken.
    """
    try:
        import rich  # noqa: PLC0415 of the extra `topside`
        import viser  # noqa: PLC0415
    except ImportError as error:
        raise SonarSimError(missing_extra(error.name or "viser", "topside")) from error
    rich.reconfigure(quiet=True)  # it prints boxes
    server = viser.ViserServer(host=host, port=port, verbose=False)
    if port not in (0, server.get_port()):  # it takes the next one that is free
        server.stop()
        raise SonarSimError(f"{host}:{port}: another program listens there; use another --page")
    server.gui.configure_theme(
        dark_mode=True, show_logo=False, show_share_button=False, brand_color=(14, 116, 144)
    )
    server.gui.set_panel_label("sonar-sim")
    server.scene.configure_default_lights(enabled=False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_ambient("/light/all", intensity=1.6)
    server.scene.add_light_directional(
        "/light/sun", intensity=1.8, position=(6.0, -9.0, 14.0), cast_shadow=False
    )
    return server


class ScenePage:
    """A page of a served scenario, in its event loop.

    Args:
        server: of the page.
        served: what is shown, entered.
        helm: moves the first vehicle; None where others drive it.
    """

    def __init__(
        self, server: "ViserServer", served: ServedScenario, helm: Helm | None = None
    ) -> None:
        self._server = server
        self._served = served
        self._helm = helm
        self._loop = asyncio.get_running_loop()
        self._view = SceneView(server.scene, served.scenarios)
        self._pictures = {one.name: PingPictures() for one in served.scenarios}
        self._latest: dict[str, tuple[bytes, TransmitState]] = {}
        self._times_s: list[float] = []
        self._offsets: dict[int, tuple[float, NDArray[np.float64]]] = {}
        for one, sonar in zip(served.scenarios, served.sonars, strict=True):
            sonar.device.on_ping = partial(self._take, one.name)
        self._panel()
        server.on_client_connect(lambda client: self._post(lambda: self._welcome(client)))
        server.on_client_disconnect(
            lambda client: self._post(lambda: self._offsets.pop(client.client_id, None))
        )

    async def run(self) -> None:
        """Draw until cancelled."""
        works = [self._move(), self._draw(), self._look()]
        if self._helm is not None:
            works.append(self._helm.run())
        async with asyncio.TaskGroup() as group:
            for work in works:
                group.create_task(work)

    def _panel(self) -> None:
        gui = self._server.gui
        names = tuple(self._pictures)
        self._shown = gui.add_dropdown("Sonar", names, visible=len(names) > 1)
        blank = np.full((300, 460, 3), 20, np.uint8)
        self._image = gui.add_image(blank)
        self._text = gui.add_markdown("")
        self._follow = gui.add_checkbox("Camera follows", initial_value=True)
        self._follow.on_update(lambda _: self._post(self._offsets.clear))
        if self._helm is None:
            return
        helm = self._helm
        self._keys: Any = gui.add_checkbox("Drive by keys", initial_value=False)
        self._keys.on_update(
            lambda event: self._post(lambda: helm.steer("keys" if event.target.value else "path"))
        )
        speed = gui.add_slider("Speed (m/s)", 0.1, 1.5, 0.1, helm.speed_mps)
        speed.on_update(
            lambda event: self._post(lambda: setattr(helm, "speed_mps", event.target.value))
        )
        for row in (("Y", "U", "I", "O"), ("H", "J", "K", "L"), ("space",)):
            labels = {f"{KEYS[key][0]} [{key}]": key for key in row}
            buttons: Any = gui.add_button_group("", tuple(labels))
            buttons.on_click(lambda event, labels=labels: self._press(labels[event.target.value]))
        for key, (name, _, _) in KEYS.items():
            hotkey: Any = key
            command: Any = gui.add_command(f"Drive: {name}", hotkey=hotkey)
            command.on_trigger(lambda _, key=key: self._press(key))

    def _press(self, key: str) -> None:
        """Take a key; called in a thread of viser."""

        def press() -> None:
            if self._helm is not None:
                self._helm.press(key)
                if not self._keys.value:
                    self._keys.value = True

        self._post(press)

    def _take(self, name: str, message: bytes, when: TransmitState) -> None:
        self._latest[name] = message, when
        if name == self._shown.value:
            self._times_s = [*self._times_s[-9:], time.monotonic()]

    async def _move(self) -> None:
        """Move what moves."""
        while True:
            now_s = self._served.route_s()
            poses = {name: route.pose(now_s) for name, route in self._served.routes.items()}
            with contextlib.suppress(RuntimeError), self._server.atomic():
                self._view.move(poses, now_s)
            here = poses[self._served.scenarios[0].vehicle.name]
            if self._follow.value:
                for client in self._server.get_clients().values():
                    self._carry(client, here.position_m, here.rotation)
            self._describe(now_s)
            await asyncio.sleep(MOVE_S)

    async def _draw(self) -> None:
        """Show the newest pings while somebody watches."""
        while True:
            await asyncio.sleep(PICTURE_S)
            latest, self._latest = self._latest, {}
            if not self._server.get_clients():
                continue
            for name, (message, when) in latest.items():
                ping = await self._loop.run_in_executor(None, ping_of, message)
                if ping is None:
                    continue
                pictures = self._pictures[name]
                mounting = next(s.mounting for s in self._served.scenarios if s.name == name)
                texture, *size_m = await self._loop.run_in_executor(None, pictures.texture, ping)
                with contextlib.suppress(RuntimeError):  # viser's threads change a list: next time
                    at = when.map_T_base @ mounting.pose
                    self._view.show_ping(name, texture, (size_m[0], size_m[1]), at)
                    if name == self._shown.value:
                        self._image.image = await self._loop.run_in_executor(
                            None, pictures.panel, ping
                        )

    async def _look(self) -> None:
        """Ping for the page alone, where no client asks for pings."""
        while True:
            for sonar in self._served.sonars:
                asked = sonar.connected and sonar.device.pinging
                if self._server.get_clients() and not asked:
                    await sonar.device.look()
            await asyncio.sleep(1.0 / self._served.scenarios[0].true_ping_rate_hz)

    def _describe(self, now_s: float) -> None:
        """State the first vehicle's pose and the shown sonar's rate."""
        route = self._served.route
        pose, velocity = route.pose(now_s), route.velocity_mps(now_s)
        east, north, up = pose.position_m
        heading = math.degrees(math.atan2(pose.rotation[0, 0], pose.rotation[1, 0])) % 360.0
        times_s = self._times_s
        span_s = times_s[-1] - times_s[0] if len(times_s) > 1 else 0.0
        rate_hz = (len(times_s) - 1) / span_s if span_s > 0.0 else 0.0
        lines = [
            f"{east:+.1f} m east, {north:+.1f} m north, {-up:.1f} m deep",
            f"heading {heading:.0f}°, {float(np.linalg.norm(velocity)):.2f} m/s",
            f"{rate_hz:.1f} pings/s",
        ]
        for name, follower in self._served.followers.items():
            lines.append(f"{name}: {follower.state} {follower.url}")
        with contextlib.suppress(RuntimeError):
            self._text.content = "  \n".join(lines)

    def _welcome(self, client: "ClientHandle") -> None:
        client.camera.up_direction = (0.0, 0.0, 1.0)

    def _carry(self, client: "ClientHandle", here_m: Any, rotation: Any) -> None:  # noqa: ANN401
        """Move a browser's camera with the vehicle; it keeps the direction that its user chose."""
        target = here_m + AHEAD_M * rotation[:, 0] * (1.0, 1.0, 0.0)
        now_s = time.monotonic()
        if client.client_id not in self._offsets:
            yaw = math.atan2(rotation[1, 0], rotation[0, 0])
            level = rotation_of(0.0, 0.0, yaw)
            self._offsets[client.client_id] = now_s, level @ (BEHIND_M - (AHEAD_M, 0.0, 0.0))
        since_s, offset = self._offsets[client.client_id]
        with contextlib.suppress(RuntimeError), client.atomic():
            if now_s - since_s > SETTLE_S:  # what a browser states before is its default
                offset = np.asarray(client.camera.position) - np.asarray(client.camera.look_at)
            client.camera.position = target + offset
            client.camera.look_at = target

    def _post(self, do: Callable[[], object]) -> None:
        """Run a function in the event loop; call from any thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(do)
