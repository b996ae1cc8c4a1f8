"""Who takes part, and how each is started."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

BENCH = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class Case:
    """One look, range and voxel size, and the files that hold its pings.

    Attributes:
        loud_share: of the pixels, those above the map's intensity threshold.
    """

    look: str
    range_m: float
    resolution_m: float
    pings_file: Path
    rays_file: Path
    loud_share: float

    @property
    def name(self) -> str:
        """As people say it."""
        return f"looking {self.look}, {self.range_m:g} m, {100 * self.resolution_m:g} cm"


@dataclass(frozen=True, slots=True)
class Contender:
    """A map and an integrator.

    Attributes:
        name: unique.
        map_name: of the map and its integrator.
        takes: what it is given of a ping.
        threads: that it may use.
        words: what distinguishes its command.
    """

    name: str
    map_name: str
    takes: str
    threads: int
    words: tuple[str, ...]

    @property
    def label(self) -> str:
        """As people say it; what the rivals take is always the same."""
        takes = f", {self.takes}" if self.is_ours else ""
        threads = f", {self.threads} threads" if self.threads > 1 else ""
        return f"{self.map_name}{takes}{threads}"

    @property
    def is_ours(self) -> bool:
        """Whether it is a map of this project."""
        return self.takes != RAYS

    def command(self, case: Case, build: Path, budget_s: float) -> list[str | Path]:
        """To run it on a case in a process of its own."""
        if not self.is_ours:
            program, *way = self.words
            return [build / program, case.rays_file, f"{case.resolution_m}", f"{budget_s}", *way]
        where = (BENCH / "our_contender.py", case.pings_file)
        return [sys.executable, *where, f"{case.resolution_m}", f"{budget_s}", *self.words]


RAYS, FIRST, FULL = "11 rays a first return", "first returns", "full image"


def _ours() -> Iterator[Contender]:
    ways = (
        ("rays", "ours, rays", 1),
        ("exact", "ours, exact", 1),
        ("default", "ours, default bound", 1),
        ("default", "ours, default bound", 2),
    )
    for way, map_name, threads in ways:
        for takes, option in ((FIRST, ("--first-returns",)), (FULL, ())):
            name = f"{way} {threads} {takes}"
            words = (way, "--threads", f"{threads}", *option)
            yield Contender(name, map_name, takes, threads, words)


OCTOMAP = Contender("octomap", "OctoMap insertPointCloud", RAYS, 1, ("octomap_rival",))
OPENVDB = tuple(
    Contender(f"openvdb {way}", f"OpenVDB, {said}", RAYS, 1, ("openvdb_rival", way))
    for way, said in (("visits", "each visit"), ("once", "once a ping"))
)
CONTENDERS = (OCTOMAP, *OPENVDB, *_ours())
EXACT_FIRST, EXACT_FULL = f"exact 1 {FIRST}", f"exact 1 {FULL}"
DEFAULT_FIRST, DEFAULT_FULL = f"default 1 {FIRST}", f"default 1 {FULL}"
RAYS_FIRST = f"rays 1 {FIRST}"
