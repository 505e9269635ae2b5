"""Cases of the robustness table: how the true vehicle and its sea differ from the vehicle file.

The name of a case is its definition: KEY=VALUE pairs. Factors multiply the values of the hull (``drag=0.5``: the true
drag is half of that before), so that the file is wrong by the inverse. Values in V are shares of the hull's top speed,
those of dead zone, quantum, wind and gust shares of the largest thrust (wind and gust: of both thrusters).
"""

from __future__ import annotations

import math

from benchmarks.strangers.flight import Conditions
from benchmarks.strangers.rigid_body import Hull
from sim.scenario import Actuators, Feature, Mismatch, SurfaceWaves, Water, Wind

CURRENT_V = 0.2
"""Speed of the steady current in every case; no estimate contains it."""
WAVE_PERIOD_S, TIDE_PERIOD_S, GUST_PERIOD_S = 4.0, 120.0, 10.0

DEFAULTS = {
    "mass": 1.0, "drag": 1.0, "thrust": 1.0, "port_thrust": 1.0, "starboard_thrust": 1.0, "arm": 1.0, "port_arm": 1.0,
    "lag_s": 0.0, "dead_time_s": 0.0, "dead_zone": 0.0, "quantum": 0.0, "wind": 0.0, "gust": 0.0, "ahead_m": 0.0,
    "abeam_m": 0.0, "noise_m": 0.0, "latency_s": 0.0, "period_s": 0.1, "waves_V": 0.0, "tide_V": 0.0, "walk_V": 0.0,
}  # fmt: skip
"""All keys, with the values of a right file and a calm sea; ``walk_V`` is per square root of a second."""

RIGHT = "right file"
CASES = (
    RIGHT,
    "mass=0.5", "mass=0.7", "mass=1.3", "mass=1.5", "mass=2",
    "drag=0.5", "drag=0.7", "drag=1.3", "drag=1.5", "drag=2",
    "thrust=0.7", "thrust=1.3", "port_thrust=0.7", "starboard_thrust=0.5",
    "arm=0.5", "arm=0.7", "arm=1.4", "port_arm=0.7",
    "lag_s=0.15", "lag_s=0.3", "lag_s=0.5", "dead_time_s=0.1", "dead_time_s=0.2", "dead_time_s=0.3",
    "wind=0.1", "wind=0.1 gust=0.05", "ahead_m=0.15", "ahead_m=-0.15", "abeam_m=0.15",
    "noise_m=0.1", "noise_m=0.3", "latency_s=0.3", "latency_s=0.5", "period_s=0.5", "period_s=1",
    "dead_zone=0.05", "quantum=0.05", "waves_V=0.15", "tide_V=0.15", "walk_V=0.01",
    "mass=2 drag=0.5 arm=0.7",
    "mass=1.3 drag=0.7 thrust=0.8",
    "mass=1.3 drag=0.7 dead_time_s=0.1",
    "mass=1.5 drag=0.5 thrust=1.4 lag_s=0.3",
    "mass=0.7 drag=0.7 thrust=1.3 latency_s=0.3",
    "lag_s=0.3 dead_time_s=0.2",
    "drag=0.7 arm=0.7 dead_zone=0.05 waves_V=0.1 ahead_m=0.15 noise_m=0.1",
)  # fmt: skip


def parsed(case: str) -> dict[str, float]:
    """Return all values of a case. Raises ``ValueError`` that names the pair."""
    values = dict(DEFAULTS)
    for pair in () if case == RIGHT else case.split():
        key, _, text = pair.partition("=")
        if key not in DEFAULTS:
            raise ValueError(f"case {case!r}: {pair!r}: must be KEY=NUMBER, KEY one of {', '.join(DEFAULTS)}")
        try:
            values[key] = float(text)
        except ValueError:
            raise ValueError(f"case {case!r}: {pair!r}: must be KEY=NUMBER, as in {key}={DEFAULTS[key]:g}") from None
    return values


def conditions(case: str, hull: Hull) -> Conditions:
    """Return the conditions of a case for one hull."""
    v, top_mps = parsed(case), hull.top_speed_mps()
    wave_m = v["waves_V"] * top_mps * WAVE_PERIOD_S / math.pi  # the orbital velocity is pi H / T
    tide = Feature(kind="tide", amplitude_mps=v["tide_V"] * top_mps, period_s=TIDE_PERIOD_S, direction_rad=1.0)
    return Conditions(
        current_mps=CURRENT_V * top_mps,
        side_force=v["wind"],
        gusts=Wind(gust_N=2.0 * v["gust"] * hull.max_N, gust_period_s=GUST_PERIOD_S),
        offset_m=(v["ahead_m"], v["abeam_m"]),
        noise_m=v["noise_m"],
        period_s=v["period_s"],
        latency_s=v["latency_s"],
        mismatch=Mismatch(
            mass=v["mass"],
            drag=v["drag"],
            thrust=v["thrust"],
            port_thrust=v["port_thrust"],
            starboard_thrust=v["starboard_thrust"],
            port_arm=v["arm"] * v["port_arm"],
            starboard_arm=v["arm"],
            extra_lag_s=v["lag_s"],
        ),
        actuators=Actuators(
            dead_time_s=v["dead_time_s"],
            dead_zone_N=v["dead_zone"] * hull.max_N,
            quantum_N=v["quantum"] * hull.max_N,
        ),
        water=Water(
            sd_mps=0.0,
            change_mps_per_rts=v["walk_V"] * top_mps,
            feature=tide if v["tide_V"] else Feature(),
            surface_waves=SurfaceWaves(height_m=wave_m, period_s=WAVE_PERIOD_S, direction_rad=0.5),
        ),
    )
