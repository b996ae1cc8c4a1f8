"""What is turned in the study of mapping, and the whole configurations beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from oculus_driver.ping import Ping
from studies.accuracy_cost.mapping.dives import Made
from studies.accuracy_cost.study import Knob, Setting, Value
from studies.report import ROOT

__all__ = [
    "KNOBS",
    "PROFILE_FOLDER",
    "PUBLISHED",
    "PUBLISHED_FILE",
    "PUBLISHED_SHIPPED",
    "WHOLES",
    "Thinning",
    "config_for",
    "flat",
    "profile",
]


PROFILE_FOLDER = ROOT / "config"


@dataclass(frozen=True, slots=True)
class Thinning:
    """What is left of an image: no setting of the daemon, but of a sonar.

    Attributes:
        beams: of so many neighbours one is kept.
        rows: so many are one, as loud as the loudest.
    """

    beams: int = 1
    rows: int = 1

    def of(self, ping: Ping) -> Ping:
        """The ping with fewer beams and rows; rows that do not fill the last one are left out."""
        if self.beams == 1 and self.rows == 1:
            return ping
        image = ping.image[:, self.beams // 2 :: self.beams]
        whole = len(image) // self.rows * self.rows
        image = image[:whole].reshape(-1, self.rows, image.shape[1]).max(axis=1)
        return replace(
            ping,
            image=np.ascontiguousarray(image),
            bearings_rad=np.ascontiguousarray(ping.bearings_rad[self.beams // 2 :: self.beams]),
            range_resolution_m=ping.range_resolution_m * self.rows,
            gains=None if ping.gains is None else ping.gains[: whole : self.rows],
        )


def config_for(setting: Setting, made: Made) -> tuple[Config, Thinning]:
    """The daemon's settings for a dive's sonar and mounting, all else by default or as overridden.

    The sonars of the dives are as high as the one that `sonar.vertical_aperture` is by default for.

    Raises:
        ConfigError: there is no such setting, or the value is not allowed.
    """
    sonar, mounting = made.sonar, made.mounting
    x, y, z = mounting.position_m
    values: dict[str, Value] = {
        "sonar.horizontal_fov": round(float(np.degrees(2.0 * sonar.half_aperture_rad)), 3),
        "mounting.position.x": x,
        "mounting.position.y": y,
        "mounting.position.z": z,
        "mounting.orientation.pitch": mounting.pitch_deg,
    }
    own = {name: v for name, v in setting.overrides.items() if name.startswith("study.")}
    values |= {name: v for name, v in setting.overrides.items() if name not in own}
    config = config_of(_tree(values), setting.label)
    asked_for = max(sonar.beams // config.device.beams, 1)  # what this sonar would have sent
    thinning = Thinning(**{name.removeprefix("study."): int(v) for name, v in own.items()})
    return config, replace(thinning, beams=thinning.beams * asked_for)


def _tree(values: Mapping[str, Value]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *sections, field = name.split(".")
        place = tree
        for section in sections:
            place = place.setdefault(section, {})
        place[field] = value
    return tree


def flat(tree: Mapping[str, Any], before: str = "") -> dict[str, Value]:
    """Sections and values as dotted names."""
    found: dict[str, Value] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{before}{name}.")
        else:
            found[before + name] = value
    return found


def profile(name: str) -> Setting:
    """One of the shipped profiles, `config/NAME.yaml`, as a whole configuration."""
    tree = yaml.safe_load((PROFILE_FOLDER / f"{name}.yaml").read_text())
    return Setting(name, flat(tree))


DEFAULT = Setting("default", {})
MARGIN = 0.05
"""Share of the error by which a default may lie behind the front: what chance makes of a lag. With
other random seeds of the basin's speckle, noise and odometry, how much another setting saves of the
default's error differs by 0.01 to 0.03 (standard deviation over six seeds); two of them."""
APERTURE_MARGIN = 0.1
"""That default is where half of an echo's power is left, whichever way the sonar looks. Narrower
ones err some 6 % less looking ahead, as the quick dives do, and 12 % more looking straight down."""
QUICK = (
    *("voxel-size", "detail", "within-ping-motion", "pose-policy", "aggregation"),
    *("adaptive", "occupied-threshold", "intensity-threshold", "elevation"),
)
"""Knobs that every test run turns: those whose default is a choice of ours."""

PUBLISHED_RULE: dict[str, Value] = {
    "sonar.vertical_aperture": 20.0,
    "mapping.integrator": "rays",
    "mapping.within_ping_motion": False,
    "adaptive.min_ratio": 0.0,
    "time_sync.policy": "latest",
}
"""sonar_3d_reconstruction: sampled sub-rays, one pose a ping, the newest, all of the aperture of
the data sheet; its other constants are those of its page of parameters, which are our defaults."""

PUBLISHED = Setting("published", PUBLISHED_RULE | {"processing.frame_skip": 5})
"""With the frame skip of its file of settings: four pings of five are thrown away."""

PUBLISHED_SHIPPED = Setting("published, every ping", PUBLISHED_RULE)
"""With the frame skip of 1 that its page of parameters names as the default."""

PUBLISHED_FILE = Setting(
    "published, its file at 0.2 m",
    PUBLISHED_RULE
    | {
        "processing.frame_skip": 5,
        "octree.voxel_resolution": 0.2,
        "filtering.intensity_threshold": 100.0,
        "filtering.min_range": 1.0,
        "iwlo.L_occ": 2.0,
        "iwlo.L_free": -4.0,
        "iwlo.L_min": -12.0,
        "iwlo.L_max": 8.0,
        "iwlo.sharpness": 0.1,
        "iwlo.min_alpha": 0.3,
    },
)
"""What it runs with as it is shipped: voxels and frame skip of its file of settings, and the
constants that its node declares, where they differ from its page of parameters."""

PROFILES = ("low_power", "balanced", "survey")
WHOLES = (PUBLISHED, PUBLISHED_SHIPPED, PUBLISHED_FILE, *(profile(name) for name in PROFILES))


def _knob(
    name: str,
    title: str,
    settings: Sequence[tuple[str, dict[str, Value]]],
    advice: str,
    *,
    published: str | None = None,
    margin: float = MARGIN,
) -> Knob:
    made = tuple(Setting(label, overrides) for label, overrides in settings)
    return Knob(name, title, made, published, margin, advice, quick=name in QUICK)


def _values(
    field: str, values: Sequence[Value], default: Value, unit: str = ""
) -> list[tuple[str, dict[str, Value]]]:
    """One setting a value; the default's has no overrides."""
    return [(f"{v}{unit}", {} if v == default else {field: v}) for v in values]


def _on_evidence(knob: Knob) -> Knob:
    """Its error is in the evidence of voxels: it changes log-odds, and surfaces hardly."""
    return replace(knob, error="log_odds_error")


def _together(edge_m: float, skip: int) -> tuple[str, dict[str, Value]]:
    return f"{edge_m} m, 256 beams, ping {skip}", {
        "octree.voxel_resolution": edge_m,
        "device.beams": 256,
        "processing.frame_skip": skip,
    }


KNOBS = (
    _knob(
        "voxel-size",
        "Voxel size",
        _values("octree.voxel_resolution", (0.05, 0.075, 0.1, 0.15, 0.2, 0.4), 0.05, " m"),
        "The first to turn: 0.1 m instead of 0.05 m moves surfaces by 1 to 2 cm; beyond 0.2 m "
        "little more is saved.",
        published="0.05 m",
    ),
    _knob(
        "together",
        "Coarser voxels, fewer beams and fewer pings together",
        [
            ("0.05 m", {}),
            ("0.05 m, ping 2", {"processing.frame_skip": 2}),
            ("0.05 m, ping 5", {"processing.frame_skip": 5}),
            *(
                _together(edge_m, skip)
                for edge_m, skip in (
                    *((0.1, skip) for skip in (1, 2, 5)),
                    *((0.2, skip) for skip in (1, 2, 5)),
                    (0.4, 1),
                )
            ),
        ],
        "Coarser first, then fewer beams, then fewer pings.",
    ),
    _knob(
        "integrator",
        "Integrator",
        [
            ("evidence_grid", {}),
            ("rays", {"mapping.integrator": "rays"}),
            ("evidence_grid, 0.1 m", {"octree.voxel_resolution": 0.1}),
            ("rays, 0.1 m", {"octree.voxel_resolution": 0.1, "mapping.integrator": "rays"}),
        ],
        "Rays use every second beam, a part of the aperture and 50 rows behind the first return; "
        "the rest is missing.",
        published="rays",
    ),
    _knob(
        "detail",
        "Detail of the evidence grid",
        _values("mapping.detail", (0.25, 0.5, 1.0, 2.0, 4.0, 8.0), 1.0),
        "A finer grid takes more time and is more exact.",
    ),
    _knob(
        "beams",
        "Beams used",
        [
            ("512", {}),
            ("256", {"device.beams": 256}),
            ("128", {"study.beams": 4}),
            ("64", {"study.beams": 8}),
        ],
        "Half of the beams save an eighth of the time at 0.05 m and a third at 0.2 m; surfaces "
        "hardly move.",
        published="256",
    ),
    _knob(
        "rows",
        "Rows used",
        [
            ("all", {}),
            ("every 2", {"study.rows": 2}),
            ("every 4", {"study.rows": 4}),
            ("every 8", {"study.rows": 8}),
        ],
        "Merged rows save no time: surfaces thicken and fill more voxels.",
    ),
    _knob(
        "elevation",
        "Vertical aperture that an echo is spread over",
        _values("sonar.vertical_aperture", (5.0, 10.0, 14.0, 17.0, 20.0, 25.0), 14.0, "°"),
        "The data sheet's 20° are one way; both ways half the power is left at 14°.",
        published="20.0°",
        margin=APERTURE_MARGIN,
    ),
    _on_evidence(
        _knob(
            "within-ping-motion",
            "Motion within the ping",
            [("true", {}), ("false", {"mapping.within_ping_motion": False})],
            "Matters for surfaces at 30 m and in fast turns (docs/concepts/mapping.md).",
            published="false",
        )
    ),
    _on_evidence(
        _knob(
            "pose-policy",
            "Pose of a ping",
            _values("time_sync.policy", ("interpolate", "nearest", "latest"), "interpolate"),
            "Costs no time.",
            published="latest",
        )
    ),
    _knob(
        "frame-skip",
        "Frame skip",
        _values("processing.frame_skip", (1, 2, 3, 5, 10), 1),
        "Saves time in proportion, and maps less.",
        published="5",
    ),
    _knob(
        "crosstalk",
        "Crosstalk filter",
        [
            ("off", {}),
            ("on", {"crosstalk.enabled": True}),
            ("on, notch too", {"crosstalk.enabled": True, "crosstalk.fft_enabled": True}),
        ],
        "Turn it on where another sonar draws stripes. The notch removes real surface.",
        published="off",
    ),
    _knob(
        "intensity-threshold",
        "Intensity threshold",
        _values("filtering.intensity_threshold", (15.0, 25.0, 35.0, 50.0, 70.0, 100.0), 35.0),
        "Higher is cheaper and sharper until it carves away the floor; it depends on gain and "
        "water.",
        published="35.0",
    ),
    _knob(
        "occupied-threshold",
        "Probability from which a voxel is occupied",
        _values("mapping.occupied_threshold", (0.5, 0.6, 0.7, 0.8, 0.9, 0.95), 0.7),
        "Costs no time; higher gives less surface, and less false surface.",
        published="0.7",
    ),
    _knob(
        "aggregation",
        "Both kinds of evidence in one ping",
        [("occupied_first", {}), ("mean", {"mapping.aggregation": "mean"})],
        "With the mean more surface is missing.",
    ),
    _knob(
        "adaptive",
        "Adaptive rule",
        [
            ("on, min_ratio 0.25", {}),
            ("on, min_ratio 0", {"adaptive.min_ratio": 0.0}),
            ("on, min_ratio 0.1", {"adaptive.min_ratio": 0.1}),
            ("off", {"adaptive.update": False}),
            ("occupied unprotected", {"adaptive.protect_occupied": False}),
        ],
        "Costs no time; off, one wrong echo counts in full.",
        published="on, min_ratio 0",
    ),
    _knob(
        "sharpness",
        "Slope from intensity to weight",
        _values("iwlo.sharpness", (0.5, 1.5, 3.0, 6.0, 12.0), 3.0),
        "Costs no time; above 3 a floor seen at an angle goes missing.",
        published="3.0",
    ),
    _knob(
        "decay-rate",
        "How fast the learning rate falls",
        _values("iwlo.decay_rate", (0.02, 0.05, 0.1, 0.2, 0.5), 0.1),
        "Costs no time.",
        published="0.1",
    ),
    _knob(
        "min-alpha",
        "Lowest learning rate",
        _values("iwlo.min_alpha", (0.02, 0.05, 0.1, 0.2, 0.4), 0.1),
        "Costs no time; it sets how long a change takes to show.",
        published="0.1",
    ),
)
