"""From a study's setting to the daemon's settings, and what the study itself does to a ping."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from oculus_driver.ping import Ping
from studies.accuracy_cost.mapping.dives import Made
from studies.accuracy_cost.study import Setting, Value
from studies.report import ROOT

__all__ = ["PROFILES", "Thinning", "config_for", "flat", "profile"]

PROFILES = ROOT / "config"


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
    said: dict[str, Value] = {
        "sonar.horizontal_fov": round(float(np.degrees(2.0 * sonar.half_aperture_rad)), 3),
        "mounting.position.x": x,
        "mounting.position.y": y,
        "mounting.position.z": z,
        "mounting.orientation.pitch": mounting.pitch_deg,
    }
    own = {name: v for name, v in setting.overrides.items() if name.startswith("study.")}
    said |= {name: v for name, v in setting.overrides.items() if name not in own}
    config = config_of(_tree(said), setting.label)
    asked_for = max(sonar.beams // config.device.beams, 1)  # what this sonar would have sent
    thinning = Thinning(**{name.removeprefix("study."): int(v) for name, v in own.items()})
    return config, replace(thinning, beams=thinning.beams * asked_for)


def _tree(said: Mapping[str, Value]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, value in said.items():
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
    tree = yaml.safe_load((PROFILES / f"{name}.yaml").read_text())
    return Setting(name, flat(tree))
