"""`sonar-sim explain SCENE`: which effects a ping calls for, why, and what each costs."""

import argparse
import json
import sys

from oculus_driver.command_line import ExitCode
from sonar_sim.command.arguments import count, positive, time_on
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import Decision, EffectPlan, EffectSelection
from sonar_sim.effects.planner import Planner
from sonar_sim.effects.previewer import Previewer
from sonar_sim.effects.rule_check import measured_costs_ms
from sonar_sim.engine import PingEngine
from sonar_sim.scene.scenario import sonar_motion, sonar_pose
from sonar_sim.scene_file import load_scenario

NAME = "explain"
HELP = "list the effects that a scene needs, why, and what they cost"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    default = Tolerance()
    parser.add_argument("scene", metavar="SCENE", help="a shipped scene's name or a YAML file")
    parser.add_argument(
        "--effects",
        default="auto",
        help="auto, all, none or names, separated by commas; then +name and -name (default: auto)",
    )
    parser.add_argument(
        "--time", type=float, default=None, help="time on the trajectory, s (default: its middle)"
    )
    parser.add_argument(
        "--tolerance-db",
        type=positive,
        default=default.level_db,
        help="tolerance of level, dB (default: %(default)s)",
    )
    parser.add_argument(
        "--tolerance-cells",
        type=positive,
        default=default.cells,
        help="tolerance of displacement, cells (default: %(default)s)",
    )
    parser.add_argument(
        "--repeats",
        type=count,
        default=3,
        help="pings to measure each cost with (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON: a list of objects")


def run(args: argparse.Namespace) -> int:
    """Print the table; warnings of missed effects go to the standard error."""
    scenario = load_scenario(args.scene)
    tolerance = Tolerance(args.tolerance_db, args.tolerance_cells)
    path = scenario.trajectory
    time_s = path.duration_s / 2.0 if args.time is None else time_on(path, args.time)
    selection = EffectSelection.read(args.effects)
    engine = PingEngine(scenario.scene, scenario.sonar)
    previewer = Previewer(scenario.scene, scenario.sonar, engine.meshes)
    pose, motion = sonar_pose(scenario, time_s), sonar_motion(scenario, time_s)
    # As in the simulator, so that both give the same result.
    planned = Planner(previewer, selection, tolerance).at(pose, 0, time_s, motion)
    plan = planned.plan
    costs_ms = measured_costs_ms(engine, plan, planned.view, args.repeats)
    _print(plan, costs_ms, as_json=args.json)
    for decision in plan.missed:
        reason = decision.verdict.reason
        sys.stderr.write(f"sonar-sim: {decision.effect.name} is switched off, but {reason}\n")
    return ExitCode.OK


def _print(plan: EffectPlan, costs_ms: dict[str, float], *, as_json: bool) -> None:
    if as_json:
        rows = [_record(d, costs_ms[d.effect.name]) for d in plan.decisions]
        print(json.dumps(rows, indent=2, ensure_ascii=False))
        return
    print(f"{'effect':<22} {'':<3} {'predicted':>9} {'cost':>9}  why")
    for decision in plan.decisions:
        verdict = decision.verdict
        print(
            f"{decision.effect.name:<22} {'on' if decision.on else 'off':<3} "
            f"{verdict.predicted_db:>6.2f} dB {costs_ms[decision.effect.name]:>6.1f} ms  "
            f"{verdict.reason}"
        )


def _record(decision: Decision, cost_ms: float) -> dict[str, object]:
    return {
        "effect": decision.effect.name,
        "on": decision.on,
        "reason": decision.verdict.reason,
        "predicted_db": round(decision.verdict.predicted_db, 3),
        "cost_ms": round(cost_ms, 3),
    }
