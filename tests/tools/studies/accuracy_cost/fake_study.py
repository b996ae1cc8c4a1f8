"""A study of known figures that takes no time; some of its settings fail as configured."""

import math
import os
import signal
import time
from pathlib import Path

from studies.accuracy_cost.study import Column, Knob, Setting, StudyDive

FIGURES = {
    "": (10.0, 1.0),
    "size=0.5": (40.0, 0.5),
    "size=2": (2.5, 2.2),
    "size=3": (3.0, 4.0),
    "way=slow": (30.0, 1.1),
    "way=good": (10.2, 0.9),
    "way=none": (1.0, math.nan),
    "old=1": (100.0, 1.5),
}
"""Cost and error by the setting's key, on a calm dive; a storm doubles the error."""


class _Fake:
    name = "fake"
    default = Setting("1", {})
    knobs = (
        Knob(
            "size", "Size",
            (Setting("0.5", {"size": 0.5}), default, Setting("2", {"size": 2}),
             Setting("3", {"size": 3})),
            "2", 0.1, "Larger is faster.", quick=True,
        ),
        Knob(
            "way", "Way",
            (default, Setting("slow", {"way": "slow"}), Setting("good", {"way": "good"}),
             Setting("none", {"way": "none"})),
            None, 0.05, "Leave it.",
        ),
    )  # fmt: skip
    dives = (StudyDive("calm", 1, quick=True), StudyDive("storm", 2))
    wholes = (Setting("published", {"old": 1}),)
    columns = (
        Column("error_m", "error, m"),
        Column("cpu_ms", "CPU, ms", repeatable=False),
        Column("share", "share", better="more"),
    )
    error = "error_m"
    cost = "cpu_ms"

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        with (folder / "prepared").open("a") as log:
            log.write(f"{dive.name}\n")
        if os.environ.get("FAKE_UNPREPARED") == dive.name:
            raise OSError("no\nsea")

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        assert (folder / "prepared").exists()
        with (folder / "measured").open("a") as log:
            log.write(f"{setting.key}\n")
        match os.environ.get(f"FAKE_{setting.label}"):
            case "raises":
                raise ValueError("no such\nsetting")
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hangs":
                time.sleep(60)
            case "forgets":
                return {"error_m": 1.0}
        cost, error = FIGURES[setting.key]
        return {
            "error_m": error * (2.0 if dive.name == "storm" else 1.0),
            "cpu_ms": cost,
            "share": 1 / 3,
        }


STUDY = _Fake()
