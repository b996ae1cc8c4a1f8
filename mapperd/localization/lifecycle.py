"""What maps, initial poses and requests do to the filter: a pure state machine.

An event makes a new state and an action, or a refusal that leaves the state as it is. The rules are
the published node's:

- A new map begins at a waiting initial pose; else at the last estimate, or with
  `always_reset_initial_pose` and `set_initial_pose` at the parameters' pose; else, where nothing is
  known yet, at the configured pose if `set_initial_pose` is true.
- `first_map_only` ignores maps once a filter is there.
- A pose in another frame is refused. Without a map it waits, the newest of several.
- The transform is published from the first pose, or request for global localization, on; a start
  anywhere on the map that only a map caused does not publish it.

And ours, where nothing is known: the published node then begins anywhere on the map. Here mode
`global` does so, as if it were requested; mode `track` waits for a pose. A map without
a free cell is refused where the vehicle would have to be anywhere on it, and the old one stays.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mapperd.config.tree import AmclConfig
from mapperd.errors import Reject
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.maps import LocalizationMap

__all__ = ["Lifecycle", "Mode", "Start", "parameter_pose"]

Mode = Literal["off", "track", "global"]


@dataclass(frozen=True, slots=True)
class Start:
    """What the filter is to do.

    Attributes:
        new_map: take the state's map first.
        at: begin with particles around this pose; None with `anywhere` False leaves them.
        anywhere: begin with particles anywhere on the map.
        given: the pose was given; else it is the last estimate, no more certain than before.
    """

    new_map: bool = False
    at: PlanarGaussian | None = None
    anywhere: bool = False
    given: bool = True

    @property
    def is_start(self) -> bool:
        """Whether to draw new particles."""
        return self.anywhere or self.at is not None


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """The state.

    Attributes:
        mode: `localization.mode`.
        map: the map in use.
        running: the filter has particles.
        publishing: the transform is published, if `tf_broadcast` is true.
        waiting: an initial pose that waits for a map.
        last: the last estimate, also one of before a restart.
    """

    mode: Mode = "track"
    map: LocalizationMap | None = None
    running: bool = False
    publishing: bool = False
    waiting: PlanarGaussian | None = None
    last: PlanarGaussian | None = None

    @property
    def name(self) -> str:
        """Of the state, for people."""
        if self.mode == "off":
            return "off"
        if self.map is None:
            return "waiting for a map"
        return "localizing" if self.running else "waiting for a pose"

    def take_map(
        self, new: LocalizationMap, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """A map has come."""
        if amcl.first_map_only and self.running:
            return Reject("first_map_only", "a map is in use and amcl.first_map_only holds it")
        at = self.waiting or self._pose_for_map(amcl)
        if at is not None:
            return self._at(at, new, new_map=True, given=at is not self.last)
        if self.mode == "global" or self.running:
            publishing = self.publishing or self.mode == "global"
            return self._anywhere(new, new_map=True, publishing=publishing)
        return replace(self, map=new), Start(new_map=True)

    def take_pose(
        self, pose: PlanarGaussian, frame: str, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """An initial pose has come.

        Args:
            pose: mean and covariance.
            frame: that it is in.
            amcl: the settings.
        """
        wrong = _wrong_frame(frame, amcl)
        if wrong is not None:
            return wrong
        if self.map is None:
            return replace(self, waiting=pose), Start()
        return self._at(pose, self.map, new_map=False)

    def localize_globally(self) -> "tuple[Lifecycle, Start] | Reject":
        """Somebody asks for a start anywhere on the map."""
        if self.map is None:
            return Reject("no_map", "there is no map to be found on")
        return self._anywhere(self.map, new_map=False, publishing=True)

    def set_map(
        self, new: LocalizationMap, pose: PlanarGaussian, frame: str, amcl: AmclConfig
    ) -> "tuple[Lifecycle, Start] | Reject":
        """Map and pose in one: both or neither. Needs a filter that runs."""
        if not self.running:
            return Reject("no_filter", "no filter is there yet; a map or a pose comes first")
        wrong = _wrong_frame(frame, amcl)
        if wrong is not None:
            return wrong
        return self._at(pose, new, new_map=True)

    def check_nomotion_update(self) -> Reject | None:
        """Why an update without motion cannot be asked for; None where it can."""
        return None if self.running else Reject("no_filter", "no filter is there yet")

    def estimated(self, estimate: PlanarGaussian) -> "Lifecycle":
        """The filter has an estimate, or one was saved before a restart."""
        return replace(self, last=estimate)

    def _pose_for_map(self, amcl: AmclConfig) -> PlanarGaussian | None:
        again = amcl.always_reset_initial_pose and amcl.set_initial_pose
        if self.last is not None and not again:
            return self.last
        return parameter_pose(amcl) if amcl.set_initial_pose else None

    def _at(
        self, pose: PlanarGaussian, known: LocalizationMap, *, new_map: bool, given: bool = True
    ) -> "tuple[Lifecycle, Start]":
        started = Lifecycle(self.mode, known, running=True, publishing=True, last=pose)
        return started, Start(new_map=new_map, at=pose, given=given)

    def _anywhere(
        self, known: LocalizationMap, *, new_map: bool, publishing: bool
    ) -> "tuple[Lifecycle, Start] | Reject":
        if not known.has_free_cells:
            return Reject("no_free_cells", "the map has no free cell that a vehicle can be in")
        started = Lifecycle(self.mode, known, running=True, publishing=publishing)
        return started, Start(new_map=new_map, anywhere=True)


def parameter_pose(amcl: AmclConfig) -> PlanarGaussian:
    """The initial pose of the settings."""
    xx, yy, aa = amcl.initial_cov_xx, amcl.initial_cov_yy, amcl.initial_cov_aa
    xy, xa, ya = amcl.initial_cov_xy, amcl.initial_cov_xa, amcl.initial_cov_ya
    covariance = np.array([[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]])
    return PlanarGaussian(amcl.initial_pose_x, amcl.initial_pose_y, amcl.initial_pose_a, covariance)


def _wrong_frame(frame: str, amcl: AmclConfig) -> Reject | None:
    if frame == amcl.global_frame_id:
        return None
    return Reject("wrong_frame", f"a pose in {frame!r}, not in {amcl.global_frame_id!r}")
