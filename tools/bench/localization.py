"""How fast the particle filter is, and how many times faster than the reference's plain loops.

The plain loops (cpp/localization/bench/plain.cpp) do what Beluga AMCL does, one particle
after the other: three normal draws and a turn a particle, each end of a beam moved, floored and
looked up, a standard line of cells a ray, a queue for the field, a binary search a sample. Both are
one program, of the same flags, and take turns within one run, so that the ratio holds on any
machine. CPU time of one thread.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import msgspec

from bench.contenders import log

CPP = Path(__file__).resolve().parents[2] / "cpp"
BEAMS = 60
PLAIN = "plain"
ABSENT = "–"  # noqa: RUF001 a dash


class Lap(msgspec.Struct, frozen=True):
    """One contender's times at one piece of work."""

    what: str
    particles: int
    who: str
    best_us: float
    median_us: float

    @property
    def per_beam_ns(self) -> float:
        """Of the best repetition, a particle and beam; 0 where particles play no part."""
        return 1e3 * self.best_us / (self.particles * BEAMS) if self.particles else 0.0


def build(folder: Path) -> Path:
    """Build the benchmark with the flags of the package; returns the program."""
    tools = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    options = "-DCMAKE_BUILD_TYPE=Release -DMAPPERD_BUILD_BINDINGS=OFF -DMAPPERD_BUILD_BENCHES=ON"
    for words in (
        ["cmake", "-G", "Ninja", "-S", str(CPP), "-B", str(folder), *options.split()],
        ["cmake", "--build", str(folder), "--target", "localization_bench"],
    ):
        subprocess.run(words, env=environment, check=True, stdout=subprocess.DEVNULL)  # noqa: S603
    return folder / "localization_bench"


def laps_of(lines: Iterable[bytes]) -> list[Lap]:
    """What the program wrote: one JSON object a line."""
    return [msgspec.json.decode(line, type=Lap) for line in lines if line.strip()]


def table(laps: list[Lap]) -> str:
    """A Markdown table, with the ratio to the plain loop of the same work and run."""
    plain = {(lap.what, lap.particles): lap for lap in laps if lap.who == PLAIN}
    lines = [
        "| work | particles | who | best, µs | median, µs | ns each beam | plain / this |",
        "|---|---|---|---|---|---|---|",
    ]
    for lap in laps:
        beside = plain.get((lap.what, lap.particles))
        ratio = f"{beside.best_us / lap.best_us:.1f}" if beside else ABSENT
        each = f"{lap.per_beam_ns:.2f}" if lap.particles else ABSENT
        count = str(lap.particles) if lap.particles else ABSENT
        lines.append(
            f"| {lap.what} | {count} | {lap.who} | {lap.best_us:.0f} | {lap.median_us:.0f} "
            f"| {each} | {ratio} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Build, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--share", type=int, default=1, help="divides the repetitions")
    parser.add_argument("--map", type=Path, help="a (1000, 1000) int8 .npy map instead of ours")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log("building")
        program = build(Path(folder))
        log("measuring")
        arguments = [str(program), str(args.share), *([str(args.map)] if args.map else [])]
        done = subprocess.run(arguments, check=True, capture_output=True)  # noqa: S603
    print(table(laps_of(done.stdout.splitlines())))


if __name__ == "__main__":
    main()
