"""`sonar-sim serve`: a scene's sonar and its vehicle's odometry on the network, in real time."""

import argparse
import asyncio
import itertools
import sys
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import replace

from oculus_driver.cli.arguments import address, count, port, positive, share
from oculus_driver.cli.output import run_until_stopped
from oculus_driver.command_line import ExitCode
from oculus_driver.models import model_of
from oculus_driver.virtual_sonar.faults import SHARES, Faults
from oculus_driver.virtual_sonar.server import broadcast_of
from oculus_driver.wire import STATUS_PORT, TCP_PORT
from sonar_sim.command.arguments import seed
from sonar_sim.device.fire_settings import part_number_of
from sonar_sim.device.server import ServedScenario, ServeSettings
from sonar_sim.effects.plan import AUTO
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.trajectory import ROUTE_ENDS, Route
from sonar_sim.navigation.formats import FORMATS
from sonar_sim.navigation.odometry_output import OdometryOutput, output_named
from sonar_sim.page.app import ScenePage, open_scene_page
from sonar_sim.page.helm import Helm
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.sonar import sonar_preset
from sonar_sim.scene_file import load_scenario

NAME = "serve"
HELP = "serve a scene as an Oculus sonar on the network, with its vehicle's odometry"

DAEMON = "native@udp:127.0.0.1:52200"
"""The odometry that the daemon expects by default."""

WATCH_S = 0.5
PAGE_PORT = 8090

_FAULT_HELP = {
    "cut": "pings that end in the middle, with the connection",
    "flip": "pings with one to eight flipped bits",
    "stall": "pings with a pause before them",
    "lose": "pings that are never sent",
    "garbage": "pings with noise in front",
    "restart": "pings before which the sonar restarts",
    "restart_ids": "pings before which ids and device time restart",
    "reorder_statuses": "statuses sent after the next one",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="name of a shipped scene, or a YAML file")
    add(
        "--model",
        choices=("M370s", "M750d", "M1200d", "M3000d"),
        help="sonar model (default: the scene's)",
    )
    add(
        "--listen",
        metavar="ADDRESS",
        type=address,
        default="127.0.0.1",
        help="address of this computer to serve at (default: %(default)s)",
    )
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add(
        "--status-to",
        metavar="ADDRESS",
        type=address,
        help="send status messages there instead of broadcasting",
    )
    add("--status-port", type=port, default=STATUS_PORT, help="UDP port (default: %(default)s)")
    add(
        "--serial",
        metavar="ID",
        type=count,
        default=ServeSettings().device_id,
        help="serial number of the sonar (default: %(default)s)",
    )
    add("--standby", action="store_true", help="stay silent until a client requests pings")
    add(
        "--ends",
        choices=ROUTE_ENDS,
        default="back",
        help="what happens at the end of the path (default: %(default)s)",
    )
    add(
        "--follow",
        metavar="[VEHICLE=]URL",
        action="append",
        default=[],
        help="take the vehicle's pose from elsewhere instead of the scene's path: udp://HOST:PORT "
        "receives native records, mavlink://HOST:PORT MAVLink from an autopilot or its simulator, "
        "mavlink+tcp://HOST:PORT connects to one; may be repeated for further vehicles",
    )
    add(
        "--page",
        metavar="PORT",
        type=port,
        nargs="?",
        const=PAGE_PORT,
        help="serve a page that shows the scene and its pings, and drives the first vehicle by "
        "keys, at this port of the address (default: %(const)s)",
    )
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add("--seed", type=seed, default=0, help="seed of all random numbers")
    add("--effects", default=AUTO, help='auto, all, or a list, such as "auto,-noise"')
    odometry = parser.add_mutually_exclusive_group()
    odometry.add_argument(
        "--odometry",
        metavar="[VEHICLE=]FORMAT@LINK",
        action="append",
        default=[],
        help=f"may be repeated (default: {DAEMON}, where the daemon listens); VEHICLE is a further "
        f"one of the scene; formats: {', '.join(FORMATS)}; links: udp:HOST:PORT, tcp:HOST:PORT, "
        "serial:PATH, pty",
    )
    odometry.add_argument("--no-odometry", action="store_true", help="send no odometry")
    faults = parser.add_argument_group("faults; SHARE is 0 to 1 of all pings")
    for name in SHARES:
        option = "--" + name.replace("_", "-")
        faults.add_argument(
            option, metavar="SHARE", type=share, default=0.0, help=_FAULT_HELP[name]
        )
    faults.add_argument(
        "--stall-s",
        metavar="S",
        type=positive,
        default=2.0,
        help="length of a pause of --stall (default: %(default)s)",
    )
    faults.add_argument("--refuse-second", action="store_true", help="refuse a second client")
    faults.add_argument(
        "--silent-after",
        metavar="S",
        type=positive,
        help="stop without a fire message for S seconds",
    )
    faults.add_argument(
        "--deaf-to-version", type=int, choices=(1, 2), help="ignore fire messages of this version"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until stopped, or until the path ends."""
    scenario = with_model(load_scenario(args.scene), args.model)
    run_until_stopped(_serve(scenario, args))
    return ExitCode.OK


def with_model(scenario: Scenario, model: str | None) -> Scenario:
    """The scenario with another sonar in its mode 1, at most at the scenario's range."""
    if model is None or model == scenario.sonar.model:
        return scenario
    preset = sonar_preset(model)
    range_m = min(scenario.sonar.demanded_range_m, preset.max_range_m)
    return replace(scenario, sonar=replace(preset, demanded_range_m=range_m))


async def _serve(scenario: Scenario, args: argparse.Namespace) -> None:
    target = args.status_to or broadcast_of(args.listen)
    first = scenario.vehicle.name
    outputs = _outputs(args, first)
    follow: dict[str, str | LivePath] = {n or first: url for n, url in map(_named, args.follow)}
    driven = args.page is not None and first not in follow
    if driven:
        follow[first] = LivePath(scenario.trajectory.pose(0.0))
    settings = ServeSettings(
        host=args.listen,
        port=args.port,
        status_to=[(target, args.status_port)],
        device_id=args.serial,
        standby=args.standby,
        ends=args.ends,
        faults=_faults(args),
        outputs=outputs.pop(first, []),
        more_outputs=outputs,
        follow=follow,
        seed=args.seed,
        effects=args.effects,
    )
    served = ServedScenario(scenario, settings)
    try:
        async with served:
            for one, sonar in zip(served.scenarios, served.sonars, strict=True):
                name = model_of(part_number_of(one.sonar.model)).name
                _report(f"an {name} in {one.name} at {sonar.host}:{sonar.port}")
            _report(f"statuses to {target}:{args.status_port}")
            for output in (*served.outputs, *itertools.chain(*settings.more_outputs.values())):
                _report(f"odometry {output.name} at {output.link.name}")
            helm = None
            if driven:
                route, path = Route(scenario.trajectory, args.ends), follow[first]
                assert isinstance(path, LivePath)  # noqa: S101 made above
                helm = Helm(route, path, served.route_s)
            await _run(served, args, helm)
    finally:
        _report(f"served: {_counted(served)}")


async def _run(served: ServedScenario, args: argparse.Namespace, helm: Helm | None) -> None:
    """Run to the end, show the page, and report where followed poses come from."""
    with ExitStack() as stack:
        works = [_watch(served)]
        if args.page is not None:
            server = open_scene_page(args.listen, args.page)
            stack.callback(server.stop)
            works.append(ScenePage(server, served, helm).run())
            _report(f"page http://{args.listen}:{server.get_port()}")
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(work) for work in works]
            with suppress(TimeoutError):  # its time counts from here on, not from the loading
                async with asyncio.timeout(args.duration):
                    await served.run()
            for task in tasks:
                task.cancel()


async def _watch(served: ServedScenario) -> None:
    states: dict[str, str] = {}
    while served.followers:
        for name, follower in served.followers.items():
            if follower.state != states.get(name):
                states[name] = follower.state
                _report(f"{name}: {follower.state} {follower.url}")
        await asyncio.sleep(WATCH_S)


def _outputs(args: argparse.Namespace, first: str) -> dict[str, list[OdometryOutput]]:
    """Outputs by the vehicle's name."""
    outputs: dict[str, list[OdometryOutput]] = {}
    for text in [] if args.no_odometry else args.odometry or [DAEMON]:
        name, form = _named(text)
        outputs.setdefault(name or first, []).append(output_named(form))
    return outputs


def _named(text: str) -> tuple[str, str]:
    """Split `[VEHICLE=]TEXT`; a link has no equals sign before its first colon."""
    head, equals, rest = text.partition("=")
    return (head, rest) if equals and ":" not in head and "@" not in head else ("", text)


def _counted(served: ServedScenario) -> str:
    counts: Counter[str] = Counter()
    for sonar in served.sonars:
        counts["pings"] += sonar.counters.pings
        counts["damaged"] += sonar.counters.pings_damaged
        counts["late"] += sonar.device.late
        counts["fire messages"] += sonar.device.fires
        counts["clients"] += sonar.counters.clients
        counts["statuses"] += sonar.counters.statuses
    counts.update({output.name: output.sent for output in served.outputs})
    for name, follower in served.followers.items():
        counts[f"poses of {name}"] += follower.records
        counts["late poses"] += follower.late
        counts["malformed"] += follower.malformed
    return ", ".join(f"{name} {value}" for name, value in counts.items() if value) or "nothing"


def _faults(args: argparse.Namespace) -> Faults:
    return Faults(
        **{name: getattr(args, name) for name in SHARES},
        stall_s=args.stall_s,
        refuse_second=args.refuse_second,
        silent_after_s=args.silent_after,
        ignored_fire_version=args.deaf_to_version,
        seed=args.seed,
    )


def _report(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
