"""The demo: simulate a survey of a harbour, map it, and compare the map with the truth.

Leaves in the output folder: capture.bin (what the vehicle's links brought), scene.ply and seen.npz
(the truth), the replay's map and pictures, demo.png and accuracy.json.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from sonar_sim import CaptureSettings, load_scenario, write_capture

from demo.map_truth import (
    MapAccuracy,
    TrueSurface,
    measure,
    read_triangles,
    read_voxels,
    write_json,
)

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config" / "demo.yaml"
SCENE = "harbour"
PICTURED_PING = 62
"""On the first leg, abreast of a pile, with the quay to port and the wreck to starboard."""
MAX_MEDIAN_M = 0.1
MIN_COVERAGE = 0.9


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; 0 if the map is as good as promised."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder of the results")
    parser.add_argument("--seed", type=int, default=CaptureSettings().seed, help="of the noise")
    args = parser.parse_args(argv)
    out: Path = args.out
    out.mkdir(parents=True, exist_ok=True)
    record(out, CaptureSettings(seed=args.seed))
    code = replay(out)
    if code != 0:
        return code
    accuracy = measure(out / "map.ply", out / "scene.ply", out / "seen.npz")
    write_json(out / "accuracy.json", accuracy)
    pictures = draw(out, accuracy)
    return report(accuracy, pictures)


def record(out: Path, settings: CaptureSettings) -> None:
    """Simulate the survey into capture.bin, and leave the truth beside it."""
    began_s = time.perf_counter()
    scenario = load_scenario(SCENE)
    capture = out / "capture.bin"
    seen = write_capture(capture, scenario, settings, _progress)
    scenario.scene.save(out / "scene.ply", seen.points_m)
    seen.save(out / "seen.npz")
    size_mb = capture.stat().st_size / 1e6
    print(f"{capture}: {size_mb:.0f} MB, simulated in {time.perf_counter() - began_s:.0f} s")


def replay(out: Path, config: Path = CONFIG) -> int:
    """Map the folder's capture with mapperd itself; returns its exit code."""
    files = {"--replay": out / "capture.bin", "--config": config, "--out": out}
    words = [str(word) for option in files.items() for word in option]
    command = [sys.executable, "-m", "mapperd", *words]
    return subprocess.run(command, check=False).returncode  # noqa: S603 our own program


def draw(out: Path, accuracy: MapAccuracy) -> list[Path]:
    """Draw demo.png where matplotlib is installed; returns the pictures that exist."""
    try:
        from demo.picture import draw_demo, read_ping  # noqa: PLC0415 matplotlib is an extra
    except ImportError as error:
        print(f"no demo.png: {error.name} is missing (pip install '.[topside]')")
    else:
        caption = (
            f"{accuracy.occupied_voxels} occupied voxels, {accuracy.median_m:.2f} m (median) from "
            f"the true surface; {accuracy.coverage:.0%} of what the sonar had in sight is mapped"
        )
        scene_m = TrueSurface(read_triangles(out / "scene.ply")).triangles_m  # small ones
        ping = read_ping(out / "capture.bin", PICTURED_PING)
        draw_demo(out / "demo.png", scene_m, read_voxels(out / "map.ply"), ping, caption)
    return [path for path in (out / "demo.png", out / "map.png") if path.exists()]


def report(accuracy: MapAccuracy, pictures: Sequence[Path]) -> int:
    """Print the quality of the map; return 0 if it is good enough."""
    print(accuracy.sentences())
    print("pictures:", *pictures)
    if accuracy.median_m <= MAX_MEDIAN_M and accuracy.coverage >= MIN_COVERAGE:
        return 0
    print(f"not as promised: median at most {MAX_MEDIAN_M} m, coverage at least {MIN_COVERAGE:.0%}")
    return 1


def _progress(done: int, of: int) -> None:
    """One line that fills; nothing where nobody watches."""
    if sys.stderr.isatty():
        bar = "#" * (40 * done // of)
        end = "\n" if done == of else ""
        sys.stderr.write(f"\rsimulating [{bar:<40}] {done}/{of} pings{end}")
        sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
