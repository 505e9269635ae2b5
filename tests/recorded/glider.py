"""A glider's dive through water made for these tests: the PD0 file its profiler would write, and where it truly went.

Down from the surface at 0.14 m/s and up again, 0.27 m/s through the water, pitch -26 and 26 deg; ensembles of ten pings
every 3.7 s, 2 m cells, 600 kHz, 30 deg beams: the kind of dive that the filter is for, not one that was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.recorded.pd0_writer import Head, Written, to_earth, written


@dataclass(frozen=True)
class World:
    """What the sea and the instrument do; defaults are the middle of what is plausible. SI, degrees where named."""

    water_mean_sd: float = 0.1
    water_sd: float = 0.06
    water_length: float = 8.0
    water_change: float = 0.001  # m/s per sqrt(s), alike over water_length
    wave_amplitude: float = 0.0  # of an internal wave of one mode, period 600 s
    river: float = 0.0  # amplitude of a current north that changes with the way north, period 150 m, less at the bottom
    noise: float = 0.014  # of a beam near the face, doubled at 25 m
    near_bias: float = 0.015  # sd by beam in the first near_cells
    near_cells: int = 2
    towards_zero: float = 0.0  # share by which the first near_cells see too little of the motion
    towards_zero_sd: float = 0.0  # by which this share differs from beam to beam
    beam_bias: float = 0.003
    scale_sd: float = 0.003  # of the speed of all beams, against that of bottom track
    outliers: float = 0.005
    bottom_noise: float = 0.007  # north and east
    bottom_m: float = 62.0
    mounting_deg: float = 0.0  # pitch of the instrument in the vehicle, whose attitude the file holds
    speed: float = 0.27
    fall: float = 0.14
    deepest: float = 41.0
    period: float = 3.7
    adapts: bool = False  # from half of the time on its cells are half as long, and twice as many


@dataclass(frozen=True)
class Dive:
    """The file, and the truth at its ensembles: t (s), position and velocity over ground, (N, 2)."""

    data: bytes
    t: np.ndarray
    depth: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


class _Water:
    """c(z, t) on nodes of 1 m: Gauss-Markov in depth, a walk in time that is Gauss-Markov in depth too."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self._world, self._rng = world, rng
        z = np.arange(0.0, 90.0)
        self._z = z
        self._root = np.linalg.cholesky(np.exp(-np.abs(z[:, None] - z) / world.water_length) + 1e-9 * np.eye(len(z)))
        self._c = world.water_mean_sd * rng.standard_normal(2) + world.water_sd * self._draw()
        self._phase = rng.uniform(0, 2 * np.pi, 2)
        self._t = 0.0

    def _draw(self) -> np.ndarray:
        return self._root @ self._rng.standard_normal((len(self._z), 2))

    def advance(self, dt: float) -> None:
        self._t += dt
        self._c = self._c + self._world.water_change * math.sqrt(dt) * self._draw()

    def at(self, z: np.ndarray, north: float) -> np.ndarray:
        mode = np.cos(np.pi * np.asarray(z) / self._world.bottom_m)[..., None]
        wave = self._world.wave_amplitude * mode * np.cos(2 * np.pi * self._t / 600 + self._phase)
        c = np.stack([np.interp(z, self._z, self._c[:, a]) for a in range(2)], axis=-1) + wave
        share = (1.0 - np.asarray(z) / (self._world.bottom_m + 1.0)).clip(0.0, 1.0) ** (1 / 6)
        c[..., 0] += self._world.river * share * math.sin(2.0 * math.pi * north / 150.0)
        return c


def dive(world: World, seed: int, *, duration: float = 420.0) -> Dive:
    """One dive of ``duration`` (s), from its first ensemble afloat."""
    rng = np.random.default_rng(seed)
    head = Head()
    water = _Water(world, rng)
    a = math.radians(head.beam_angle_deg)
    rdi = np.array([[-math.sin(a), 0, -math.cos(a)], [math.sin(a), 0, -math.cos(a)]])
    rdi = np.vstack([rdi, np.array([[0, math.sin(a), -math.cos(a)], [0, -math.sin(a), -math.cos(a)]])])
    d = head.first_cm / 100 + head.cell_cm / 100 * np.arange(head.cells)
    near = world.near_bias * rng.standard_normal((head.cells, 4)) * (np.arange(head.cells) < world.near_cells)[:, None]
    share = world.towards_zero + world.towards_zero_sd * rng.standard_normal(4)
    shrink = 1 - share * (np.arange(head.cells) < world.near_cells)[:, None]
    bias = world.beam_bias * rng.standard_normal(4)
    scale = 1 + world.scale_sd * rng.standard_normal()
    course = rng.uniform(0, 360)
    turn = rng.uniform(-50, 50)
    position, depth, frames = np.zeros(2), 0.0, []
    log: list[tuple[float, float, np.ndarray, np.ndarray]] = []
    t, sign = 0.0, 1.0
    steps = 4
    while t < duration:
        if world.adapts and t > duration / 2 and head.cell_cm == 200:
            head = Head(cells=2 * head.cells, cell_cm=100, first_cm=244)
            d = head.first_cm / 100 + head.cell_cm / 100 * np.arange(head.cells)
            near, shrink = np.repeat(near, 2, axis=0), np.repeat(shrink, 2, axis=0)
        if depth > world.deepest:
            sign = -1.0
        heading = course + turn * min(t / 110, 1.0) + 5 * math.sin(t / 17)
        through = world.speed * np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading))])
        velocity = water.at(np.array([depth]), position[0])[0] + through
        pitch = -26.0 * sign + 0.5 * rng.standard_normal()
        beams = rdi, d, near + bias, shrink * scale
        moment = t, depth, position, velocity, sign, heading, pitch
        frames.append(_ensemble(world, head, water, rng, *beams, *moment))
        log.append((t, depth, position.copy(), velocity))
        dt = world.period * (1 + 0.05 * rng.uniform(-1, 1))
        dt = round(dt, 2)
        for _ in range(steps):
            position = position + velocity * dt / steps
            depth = max(depth + sign * world.fall * dt / steps, 0.0)
            water.advance(dt / steps)
            velocity = water.at(np.array([depth]), position[0])[0] + through
        t = round(t + dt, 2)
    times, depths, positions, velocities = zip(*log, strict=True)
    return Dive(b"".join(frames), np.array(times), np.array(depths), np.array(positions), np.array(velocities))


def _ensemble(
    world, head, water, rng, rdi, d, bias, factor, t, depth, position, velocity, sign, heading, pitch
) -> bytes:
    """Its bytes. Beams are those of the instrument as mounted; bins are mapped to depths."""
    tilted = pitch + world.mounting_deg
    to_enu = to_earth(head, heading, tilted, 3.5)
    enu = rdi @ to_enu.T  # (4, 3)
    below = np.tile(d[:, None], 4)  # mapped bins are at one depth in every beam
    c = water.at(depth + below, position[0])  # (cells, 4, 2), north and east
    relative = np.empty((head.cells, 4, 3))
    relative[..., 0] = c[..., 1] - velocity[1]
    relative[..., 1] = c[..., 0] - velocity[0]
    relative[..., 2] = sign * world.fall  # the water comes up
    b = -np.einsum("cbx,bx->cb", relative, enu) * factor + bias
    sd = world.noise * (1 + (d / 25) ** 2)
    b += sd[:, None] * rng.standard_normal(b.shape)
    b[rng.random(b.shape) < world.outliers] += 0.5
    down = -enu[:, 2]
    lost = rng.random(b.shape) < 1 / (1 + np.exp(-(d[:, None] / down - 24) / 2))
    b[lost | (d[:, None] / down > 32)] = np.nan
    floor = world.bottom_m - depth
    b[d > 0.9 * floor * down.min()] = np.nan
    range_m = floor / down  # along the beam
    bottom = np.array([-velocity[1], -velocity[0], sign * world.fall])
    bottom[:2] += world.bottom_noise * rng.standard_normal(2)
    along = d[:, None] / math.cos(math.radians(head.beam_angle_deg))
    echo = 60 + 50 * np.exp(-along / 12) + 45 * np.exp(-0.5 * ((along - range_m) / 1.5) ** 2)
    ensemble = Written(
        t_s=t,
        beams_mps=b,
        heading_deg=heading % 360,
        pitch_deg=tilted,
        said_pitch_deg=pitch,
        roll_deg=3.5,
        depth_m=round(depth, 1),
        number=1 + round(t / world.period),
        bottom_beams_mps=-(enu @ bottom),
        bottom_range_m=range_m * math.cos(math.radians(head.beam_angle_deg)),
        echo=np.round(echo),
    )
    return written(head, ensemble)
