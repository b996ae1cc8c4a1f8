"""Check the simulator's rules on every shipped scene, and write the figures into docs/.

Three pings of each scene, of the beginning, middle and end of its path, are simulated with what
the rules chose, with all effects, and without each of the chosen ones;
`sonar_sim.effects.rule_check` states what must hold. Some five minutes of one core.
"""

import argparse
import sys

from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.registry import EFFECTS, effects_markdown
from sonar_sim.effects.rule_check import PictureDifference, RuleCheck, RuleChecker
from sonar_sim.scene_file import load_scenario, scene_names
from tqdm import tqdm

from studies.report import PAGES, write_section

PARTS = (0.05, 0.5, 0.95)


def main() -> int:
    """Check; 1 if a rule is wrong."""
    parser = argparse.ArgumentParser(description="check the rules of the simulator's effects")
    parser.add_argument("scenes", nargs="*", default=scene_names())
    parser.add_argument("--at", type=float, nargs="*", default=PARTS, help="parts of each path")
    parser.add_argument("--write", action="store_true", help="into docs/reports/simulator.md")
    arguments = parser.parse_args()
    checks = {}
    stops = [(name, part) for name in arguments.scenes for part in arguments.at]
    for name, part in tqdm(stops, unit="ping", disable=None):
        scenario = load_scenario(name)
        check = RuleChecker(scenario).check(part * scenario.trajectory.duration_s)
        checks[f"{name} at {part:.0%}"] = check
        for fault in check.faults:
            print(f"{name} at {part:.0%}: {fault}", flush=True)
    text = figures(checks)
    print(text)
    if arguments.write:
        write_section(PAGES["simulator-effects"], "effects", effects_markdown())
        write_section(PAGES["simulator"], "check", text)
    return 1 if any(check.faults for check in checks.values()) else 0


def figures(checks: dict[str, RuleCheck]) -> str:
    """A row a ping: what `auto` leaves out of `all`, and the effect that matters least."""
    lines = [
        "| ping | effects on | left out: dB, cells, texture | the least of those on, without it |",
        "|---|---|---|---|",
    ]
    for name, check in checks.items():
        least = min(check.without, key=lambda n: _weight(check.without[n], check.tolerance))
        idle = " (idle)" if check.without[least].within(check.tolerance) else ""
        wrong = "" if check.left_out.within(check.tolerance) else " (too much)"
        lines.append(
            f"| {name} | {len(check.without)} of {len(EFFECTS)} | {_text(check.left_out)}{wrong} "
            f"| `{least}`: {_text(check.without[least])}{idle} |"
        )
    return "\n".join(lines) + "\n"


def _text(change: PictureDifference) -> str:
    cells = "-" if change.cells is None else f"{change.cells:.2f}"
    return f"{change.level_db:.2f}, {cells}, {change.texture:.3f}"


def _weight(change: PictureDifference, tolerance: Tolerance) -> float:
    """The largest of a change's three over its tolerance."""
    return max(
        change.level_db / tolerance.level_db,
        (change.cells or 0.0) / tolerance.cells,
        change.texture / tolerance.texture,
    )


if __name__ == "__main__":
    sys.exit(main())
