"""One ping of a scene, with exactly the effects that a `Physics` calls for."""

import copy
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.geometry.pose import FramePose, SonarMotion, require_finite
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.clouds import cloud_power
from sonar_sim.propagation.ground_truth import Truth, truth_of
from sonar_sim.propagation.physics import Mirror, Physics
from sonar_sim.propagation.point_targets import add_targets
from sonar_sim.propagation.propagation_path import (
    PingGeometry,
    audible_materials,
    direct_paths,
    mirror_paths,
)
from sonar_sim.propagation.refraction import refracted_paths
from sonar_sim.raycast.fan import ELEVATIONS, MARGIN_BEAMS, ray_fan
from sonar_sim.raycast.meshes import Meshes
from sonar_sim.raycast.tracing import Trace, trace
from sonar_sim.raycast.visible_surface import visible_points
from sonar_sim.receiver.beamformer import BeamFormer, beam_former, cells_share, column_taps
from sonar_sim.receiver.gain import amplitude as received
from sonar_sim.receiver.gain import quantise, ring_down_power_db, row_gain
from sonar_sim.receiver.noise import (
    add_arrival,
    add_crosstalk,
    add_random,
    add_tail,
    diffuse_limit_m2,
    noise_rms,
    pose_key,
    stream_key,
    volume_rms,
)
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings

Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32] | NDArray[np.float32]
Cells = NDArray[np.complex64] | NDArray[np.float32]

NODES_PER_BEAM = 8.0
"""Scatterers in a row of a beam's -3 dB width, about: the coefficient of variation of an even floor
is then within 0.002 of Rayleigh's."""
GHOST_DENSITY = 0.6
"""Scatterers of an area that is heard by way of a mirror, over those of one heard straight: the
coefficient of variation is within 0.011 of Rayleigh's."""
CAST_RANGE_FACTOR = 1.3
"""Rays are cast to this multiple of the last row's range: a patch hit beyond it may begin before
it."""
VERTICAL_STEPS = 2048
MALLOC_WARMUP_BYTES = 31 << 20
"""Freeing an array of this size raises glibc's mmap threshold to it, and its trim threshold to
twice as much; 32 MiB is the limit."""


@dataclass(frozen=True, eq=False)
class EnginePing:
    """What one ping gives.

    Attributes:
        image: (rows, beams), row 0 nearest, column 0 the most negative bearing; unsigned integers
            of the sonar's width, or float32 parts of full scale where `Physics.quantised` is off.
        amplitude: (rows, beams), parts of full scale after the gains, before clipping and gamma.
            With speckle off, the root of the mean power.
        truth: what each ray and each pixel shows, if it was asked for.
        stage_ms: wall time of each stage.
        rays: where the rays went.
        map_T_sonar, sonar: of the ping.
    """

    image: Image
    amplitude: NDArray[np.float32]
    truth: Truth | None
    stage_ms: dict[str, float]
    rays: Trace
    map_T_sonar: FramePose  # noqa: N815 frames of a transform
    sonar: SonarSettings

    @cached_property
    def seen_m(self) -> NDArray[np.float64]:
        """Points of visible surfaces, map frame, (N, 3); see `raycast.visible_surface`."""
        return visible_points(self.rays, self.sonar)


class PingEngine:
    """A sonar in a scene. Equal seed, pose, physics, number and time give equal bytes.

    Args:
        scene: what can echo.
        sonar: settings.
        seed: of the surfaces' speckle and the receiver's noise.
        threads: at most; the bytes do not depend on it.
        nodes_per_beam: scatterers in a row of a beam's -3 dB width, about.
        elevations: rays of a column.

    Raises:
        SceneError: a surface has a vertex that is not finite.
    """

    def __init__(
        self,
        scene: Scene,
        sonar: SonarSettings,
        seed: int = 0,
        threads: int = 2,
        *,
        nodes_per_beam: float = NODES_PER_BEAM,
        elevations: int = ELEVATIONS,
    ) -> None:
        self.scene = scene
        self.sonar = sonar
        self._seed = seed
        self._threads = max(threads, 1)
        self._nodes_per_cell = nodes_per_beam / max(sonar.beam_width_rad / sonar.sine_pitch, 1.0)
        # The sonar compensates the water's absorption, even if it is not simulated.
        self._assumed_db_per_m = scene.water.absorption_db_per_m(sonar.frequency_hz)
        self._meshes = Meshes(scene)
        self._loudest_mu = float(self._meshes.strengths[:, 0].max(initial=0.0))
        self._fan = ray_fan(sonar, elevations)
        self._elevations = elevations
        self._volume: (
            tuple[tuple[object, ...], tuple[NDArray[np.float32], NDArray[np.float32]]] | None
        ) = None
        self._former: tuple[tuple[object, ...], BeamFormer] | None = None
        # Otherwise each ping of a small scene returns 10 MB to the system, and needs it again.
        np.empty(MALLOC_WARMUP_BYTES, dtype=np.uint8)

    @property
    def meshes(self) -> Meshes:
        """The scene's triangles, ready to be met by rays."""
        return self._meshes

    def reseeded(self, seed: int) -> "PingEngine":
        """The same engine with another seed; meshes, fan and caches are shared."""
        other = copy.copy(self)
        other._seed = seed  # noqa: SLF001 one of ours
        return other

    def ping(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        physics: Physics,
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
        *,
        truth: bool = False,
    ) -> EnginePing:
        """Simulate one ping.

        Args:
            map_T_sonar: the sonar's pose at the transmission.
            physics: what to compute.
            ping_id: names the noise; equal numbers give equal noise.
            time_s: of the transmission; moving objects stand where they are then.
            motion: of the sonar while it listens: for the blocks of poses and the Doppler shift.
            truth: whether to work out the truth of rays and pixels.

        Raises:
            SonarSimError: the pose, the motion or the time is not finite.
        """
        moving = () if motion is None else (motion.linear_mps, motion.angular_rps)
        require_finite(map_T_sonar, time_s, *moving)
        clock = _StageTimer()
        here = self._situation(map_T_sonar, physics, time_s, motion)
        rays, ways = self._ways(here)
        clock.lap("casting")
        cells = self._surfaces(here, rays, ways)
        clock.lap("scattering")
        former = self._beam_former(physics)
        self._fill(cells, here, rays, former, ping_id)
        clock.lap("cells")
        beams: Cells = former.form(cells, self._threads)  # type: ignore[type-var, assignment]
        if not physics.speckle:
            # The weights between columns have negative lobes, which the beams' patterns fill; what
            # is left is rounding. Before that, a thin object alone would gain what is cut off.
            np.clip(beams, 0.0, None, out=beams)
        if physics.crosstalk_db is not None:
            add_crosstalk(beams, physics.crosstalk_db, stream_key(self._seed, "crosstalk"))
        clock.lap("beams")
        gain = row_gain(self.sonar, physics, self._assumed_db_per_m)
        amplitude = received(beams, gain, self._threads)
        image = quantise(amplitude, physics, self.sonar.gamma_byte, self.sonar.bits, self._threads)
        clock.lap("receiver")
        wavelength_m = self.scene.water.speed_of_sound_mps / self.sonar.frequency_hz
        shown = truth_of(rays, self._meshes, self.sonar, here, wavelength_m) if truth else None
        return EnginePing(image, amplitude, shown, clock.laps_ms, rays, map_T_sonar, self.sonar)

    def _situation(
        self, pose: FramePose, physics: Physics, time_s: float, motion: SonarMotion | None
    ) -> PingGeometry:
        range_m = self.sonar.range_m / physics.range_scale
        names = tuple(surface.name for surface in self.scene.surfaces)
        return PingGeometry(
            meshes=self._meshes,
            physics=physics,
            pose=pose,
            motion=motion,
            time_s=time_s,
            listening_s=2.0 * range_m / self.scene.water.speed_of_sound_mps,
            range_m=range_m,
            heard=audible_materials(names, physics),
            threads=self._threads,
        )

    def _ways(self, here: PingGeometry) -> tuple[Trace, list[_core.Rays]]:
        """Where the rays go, and the ways of the sound from there."""
        physics, reach_m = here.physics, CAST_RANGE_FACTOR * here.range_m
        fan = ray_fan(self.sonar, self._elevations, physics.elevations_rad)
        if physics.layers is not None:
            speed = self.scene.water.speed_of_sound_mps
            rays, ways = refracted_paths(here, physics.layers, fan, reach_m, speed)
        else:
            rays = trace(
                self._meshes,
                fan,
                here.pose,
                here.time_s,
                reach_m,
                shadows=physics.shadows,
                threads=self._threads,
            )
            ways = direct_paths(here, rays)
        return rays, ways

    def _surfaces(self, here: PingGeometry, rays: Trace, ways: list[_core.Rays]) -> Cells:
        """What surfaces and targets send back, straight and by mirrors, (rows, columns)."""
        physics = here.physics
        cells = self._scattered(ways, physics, self._setting(physics), self._threads)
        if physics.mirrors:
            workers = min(self._threads, len(physics.mirrors))
            share = replace(here, threads=self._threads // workers)
            if workers == 1:
                for mirror in physics.mirrors:
                    cells += self._ghosts(share, rays, mirror)
            else:
                with ThreadPoolExecutor(workers) as pool:
                    for ghosts in pool.map(partial(self._ghosts, share, rays), physics.mirrors):
                        cells += ghosts
        loss, taps = self._loss(physics), column_taps(self.sonar, physics)
        turns = self.sonar.frequency_hz / self.scene.water.speed_of_sound_mps
        add_targets(
            cells, self.scene.targets, here, self.sonar, loss=loss, taps=taps, turns_per_m=turns
        )
        return cells

    def _ghosts(self, here: PingGeometry, rays: Trace, mirror: Mirror) -> Cells:
        """What surfaces send back by way of a mirror, (rows, columns)."""
        physics, reach_m = here.physics, CAST_RANGE_FACTOR * here.range_m
        fan = ray_fan(self.sonar, self._elevations, physics.mirrored_elevations_rad)
        # The same rays lead to the mirror.
        same = fan is ray_fan(self.sonar, self._elevations, physics.elevations_rad)
        ways = mirror_paths(here, fan, mirror, reach_m, rays.coarse if same else None)
        setting = self._setting(physics, GHOST_DENSITY)
        return self._scattered(ways, physics, setting, here.threads)

    def _scattered(
        self,
        ways: list[_core.Rays],
        physics: Physics,
        setting: _core.ScatterSetting,
        threads: int,
    ) -> Cells:
        """What surfaces send back by some ways, (rows, columns)."""
        shape = (self.sonar.rows, self._fan.columns)
        faces = self._meshes.faces
        if physics.speckle:
            field = np.zeros(shape, dtype=np.complex64)
            for way in ways:
                _core.scatter_field(field, faces, way, setting, threads)
            return field
        power = np.zeros(shape, dtype=np.float32)
        for way in ways:
            _core.scatter_power(power, faces, way, setting, threads)
        return power

    def _setting(self, physics: Physics, density: float = 1.0) -> _core.ScatterSetting:
        return _core.ScatterSetting(
            loss=self._loss(physics),
            vertical=_vertical_pattern(physics.vertical_width_rad),
            taps=column_taps(self.sonar, physics),
            columns=self._fan.columns,
            row_m=self.sonar.range_resolution_m,
            first_sine=self._fan.first_sine,
            sine_pitch=self._fan.sine_pitch,
            range_scale=physics.range_scale,
            lambert=physics.lambert,
            specular=physics.specular,
            spreading=physics.spreading,
            turns_per_m=self.sonar.frequency_hz / self.scene.water.speed_of_sound_mps,
            nodes_per_cell=density * self._nodes_per_cell,
            key=stream_key(self._seed, "surfaces"),
        )

    def _loss(self, physics: Physics) -> NDArray[np.float32]:
        """Pressure at each row's range, of source level and absorption both ways, (rows,)."""
        range_m = self.sonar.row_centres_m / physics.range_scale
        level_db = self.sonar.source_level_db - 2.0 * physics.attenuation_db_per_m * range_m
        loss: NDArray[np.float32] = (10.0 ** (level_db / 20.0)).astype(np.float32)
        return loss

    def _fill(
        self, cells: Cells, here: PingGeometry, rays: Trace, former: BeamFormer, ping_id: int
    ) -> None:
        """Add what is no surface: water, clouds, noise, other sonars."""
        physics, seed = here.physics, self._seed
        if physics.reverberation is not None:
            wavelength_m = self.scene.water.speed_of_sound_mps / self.sonar.frequency_hz
            key = pose_key(seed, here.pose, wavelength_m)
            limit = diffuse_limit_m2(self.sonar, self._loudest_mu)
            limit *= np.square(self._loss(physics), dtype=np.float64)
            if physics.spreading:
                limit /= (self.sonar.row_centres_m / physics.range_scale) ** 4
            add_tail(
                cells,
                physics.reverberation,
                self.sonar,
                limit=limit,
                key=key,
                shared=cells_share(self.sonar, physics),
                threads=self._threads,
            )
        # One draw for noise, water and clouds, as all are new in each ping: plankton drifts on.
        row_rms = noise_rms(self.sonar, physics, former.noise_gain)
        column_rms = np.ones(self._fan.columns, dtype=np.float32)
        extra_power = None
        if physics.clouds:
            extra_power = cloud_power(physics, self.sonar, rays, self._loss(physics))
        if physics.volume_strength_db is not None:
            noise = np.square(row_rms)[:, None]
            extra_power = noise if extra_power is None else extra_power + noise
            row_rms, column_rms = self._volume_rms(physics)
        if extra_power is not None or physics.noise_level_db is not None:
            key = stream_key(seed, "noise", ping_id)
            add_random(cells, row_rms, column_rms, key, self._threads, extra_power=extra_power)
        if physics.ring_down_db is not None:
            level_db = ring_down_power_db(self.sonar, physics.ring_down_db, self._assumed_db_per_m)
            rms = (10.0 ** (level_db / 20.0) / former.noise_gain).astype(np.float32)
            level = np.ones(self._fan.columns, dtype=np.float32)
            # The electronics ring alike after each transmission.
            add_random(cells, rms, level, stream_key(seed, "ring"), self._threads)
        for number, arrival in enumerate(physics.arrivals):
            key = stream_key(seed, "arrival", ping_id, number)
            speed = self.scene.water.speed_of_sound_mps
            add_arrival(cells, arrival, self.sonar, speed, key)

    def _volume_rms(self, physics: Physics) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The last one, while the settings that shape it stay."""
        shape = (
            physics.volume_strength_db,
            physics.attenuation_db_per_m,
            physics.spreading,
            physics.vertical_width_rad,
        )
        if self._volume is None or self._volume[0] != shape:
            self._volume = (shape, volume_rms(self.sonar, physics, self._fan.columns))
        return self._volume[1]

    def _beam_former(self, physics: Physics) -> BeamFormer:
        """The last one, while the settings that shape it stay."""
        shape = (
            physics.beam_width_rad,
            physics.side_lobe_db,
            physics.focus_m,
            physics.range_spread,
            physics.sine_bearings,
        )
        if self._former is None or self._former[0] != shape:
            self._former = (shape, beam_former(self.sonar, physics, MARGIN_BEAMS))
        return self._former[1]


@dataclass(slots=True)
class _StageTimer:
    """Wall time of a ping's stages."""

    laps_ms: dict[str, float] = field(default_factory=dict)
    _last_s: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps_ms[name] = 1e3 * (now - self._last_s)
        self._last_s = now


@lru_cache(maxsize=8)
def _vertical_pattern(width_rad: float | None) -> NDArray[np.float32]:
    """One-way pressure of the vertical pattern over the sine of elevation from 0 to 1."""
    if width_rad is None:
        return np.ones(2, dtype=np.float32)
    up = np.linspace(0.0, 1.0, VERTICAL_STEPS)
    pressure = (vertical_two_way_power(up, width_rad) ** 0.25).astype(np.float32)
    pressure.setflags(write=False)
    return pressure
