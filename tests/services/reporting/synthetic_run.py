"""A dive made by hand, whose every number is known: what plots, report and page are tested on.

The vehicle moves north at 0.1 m/s and sinks at 0.2 m/s. The estimate begins 3 m north and 4 m west of it and drifts
east by 0.01 m/s; the variance of its position is 9 m2 at t = 0 and grows by 0.01 m2/s.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from ltv_mpc import messages
from services.bus.outbox import Outbox
from services.bus.session import Session
from services.bus.wire import Header
from services.recording.writer import RunWriter
from services.reporting.plots import collector
from tests.ltv_mpc import reports as actuators
from tests.ltv_mpc.plans import plan_of
from tests.services.words import running_clock

S = 1_000_000_000
OFFSET = (3.0, -4.0)
DRIFT_EAST_MPS = 0.01
SPEED_NORTH_MPS = 0.1
START_VARIANCE_M2 = 9.0
GROWTH_M2_PER_S = 0.01
TARGET = (1.0, 2.0)
CYCLE_NS = 300_000_000
SOLVED = messages.PlanOrigin.SOLVED
EPOCH = 7
NIS = 0.9
INNOVATIONS, INNOVATION_SDS = (0.1, -0.1, 0.02, 0.0), (0.3, 0.4, 0.01, 0.01)
NODES = ("plant", "sensors", "estimator", "controller", "recorder")
BASIN, WRECK = 'keep_in[0] "basin"', 'keep_out_disc[0] "wreck"'

VEHICLE = (Path(__file__).parents[3] / "ltv_mpc" / "vehicle" / "files" / "paper.toml").read_text()


def truth(t_ns: int) -> messages.Truth:
    t = t_ns / S
    return messages.Truth(
        t_ns=t_ns,
        position_m=(SPEED_NORTH_MPS * t, 0.0, max(0.0, 0.2 * t)),
        velocity_mps=(SPEED_NORTH_MPS, 0.0, 0.2),
        attitude_rad=(0.0, 0.0, 0.0),
        water_velocity_mps=(0.1, 0.0, 0.2),
        yaw_rate_radps=0.0,
        current_mps=(0.03, -0.02),
        thrust_N=(10.0, -10.0, 62.5),
    )


def estimate(t_ns: int) -> messages.Estimate:
    t = t_ns / S
    covariance = np.diag([0.0, 0.0, 1e-4, 1e-4, 1e-4, 1e-4])
    covariance[0, 0] = covariance[1, 1] = START_VARIANCE_M2 + GROWTH_M2_PER_S * max(0.0, t)
    return messages.Estimate(
        t_ns=t_ns,
        north_m=SPEED_NORTH_MPS * t + OFFSET[0],
        east_m=OFFSET[1] + DRIFT_EAST_MPS * t,
        heading_rad=0.0,
        yaw_rate_radps=0.0,
        velocity_north_mps=SPEED_NORTH_MPS,
        velocity_east_mps=0.0,
        depth_m=max(0.0, 0.2 * t),
        velocity_down_mps=0.2,
        covariance=covariance,
        current=messages.CurrentProfile(
            depth_m=np.array([0.0, 10.0, 20.0]),
            north_mps=np.array([0.03, 0.02, 0.01]),
            east_mps=np.array([-0.02, 0.0, 0.02]),
            sd_mps=np.array([0.01, 0.02, 0.03]),
        ),
    )


def plan(t_ns: int, *, origin: messages.PlanOrigin = SOLVED, target: tuple[float, float] = TARGET) -> messages.Plan:
    knots = 8
    times = t_ns + CYCLE_NS // 2 + CYCLE_NS * np.arange(knots)
    states = np.zeros((knots, 6))
    states[:, 0] = OFFSET[0] + SPEED_NORTH_MPS * times / S
    states[:, 1] = OFFSET[1]
    return plan_of(
        times[0],
        np.tile([20.0, -20.0, 62.5], (knots, 1)),
        CYCLE_NS,
        cycle_t_ns=t_ns,
        states=states,
        origin=origin,
        solve=messages.Solve(status=messages.SolveStatus.SOLVED, iterations=25),
        why="" if origin is SOLVED else "OSQP: iteration limit",
        reference_m=target,
        reference_depth_m=40.0,
        fence=messages.FenceReport(clearance_m=3.0, nearest=WRECK, active=(WRECK,)),
    )


def applied(t_ns: int) -> messages.Applied:
    cycle_ns = t_ns // CYCLE_NS * CYCLE_NS
    followed = {"plan_epoch": EPOCH, "plan_sequence": 0, "plan_cycle_t_ns": cycle_ns}
    return actuators.report(t_ns, (15.0, -15.0, 62.5), **followed, plan_received_t_ns=cycle_ns + 50_000_000)


def timing(t_ns: int, *, wall_ms: float = 2.0) -> messages.CycleTiming:
    stages = {"read": 100.0, "predict": 400.0, "linearise": 200.0, "build": 50.0, "update": 150.0, "solve": 500.0}
    return messages.CycleTiming(
        t_ns=t_ns,
        compute_ns=round(wall_ms * 1e6 * 10),
        compute_wall_ns=round(wall_ms * 1e6),
        estimate_age_ns=100_000_000,
        stage_us={**stages, "publish": 300.0},
    )


def report(t_ns: int) -> messages.LocalisationReport:
    """Return a report in which every sensor that corrects the filter is a little too good."""
    ok = messages.SensorStatus.OK
    sensors = tuple(
        messages.SensorReport(sensor=name, status=ok, used=20, rejected={}, nis=NIS, last_t_ns=t_ns)
        for name in collector.NIS
    )
    innovations = tuple(
        messages.InnovationSample(sensor=name, t_ns=t_ns, rows=(0, 1, 2, 3), innovations=INNOVATIONS, sd=INNOVATION_SDS)
        for name in collector.NIS
    )
    return messages.LocalisationReport(
        t_ns=t_ns,
        status=messages.FilterStatus.NOMINAL,
        why="",
        restarts=0,
        water_walk_mps_per_rts=0.0,
        sensors=sensors,
        innovations=innovations,
    )


def clock(t_ns: int, *, speed: int = 10) -> messages.Clock:
    return replace(running_clock(0, epoch=EPOCH, vehicle_ns=t_ns), speed_num=speed, requested_speed=float(speed))


def fence(t_ns: int) -> messages.FenceInForce:
    """Return a square to stay in, a disc that bounds the plan, and a ship that crosses."""
    wreck = np.array([[9.0, -4.0]])
    square = np.array([[-30.0, -30.0], [-30.0, 30.0], [30.0, 30.0], [30.0, -30.0]])
    ship = messages.Obstacle(
        id=7, t_ns=t_ns, north_m=12.0, east_m=-20.0, velocity_north_mps=0.0, velocity_east_mps=1.0, radius_m=2.0
    )
    return messages.FenceInForce(
        t_ns=t_ns,
        hull_radius_m=1.0,
        zones=(
            messages.ZoneInForce(label=BASIN, keep_in=True, vertices_m=square, radius_m=0.0, margin_m=2.0),
            messages.ZoneInForce(label=WRECK, keep_in=False, vertices_m=wreck, radius_m=1.0, margin_m=1.0),
        ),
        obstacles=(ship,),
    )


ARM = messages.Command(command_id=1, action=messages.Action.ARM)
ARMED = messages.Acknowledgement(t_ns=0, command_id=1, accepted=True, authority=messages.Authority.CONTROLLER, why="")
EVENT = messages.RunEvent(t_ns=5 * S, node="plant", kind="test", text="</script><b>a mark</b>")


def dive(until_s: float = 20.0) -> Iterator[tuple[str, messages.Message, int]]:
    """Yield writer, message and vehicle time of publication, from one second before t = 0."""
    yield "plant", clock(-S), -S
    yield "operator", ARM, -S
    yield "controller", ARMED, -S
    for t_ns in range(-S, round(until_s * S) + 1, 50_000_000):
        yield "plant", truth(t_ns), t_ns
        if t_ns % 100_000_000 == 0:
            yield "plant", applied(t_ns), t_ns
            yield "estimator", estimate(t_ns), t_ns
        if t_ns % CYCLE_NS == 0:
            yield "controller", plan(t_ns), t_ns
            yield "controller", timing(t_ns), t_ns
        if t_ns % S == 0:
            yield "estimator", report(t_ns), t_ns
            yield "controller", fence(t_ns), t_ns
        if t_ns == EVENT.t_ns:
            yield "plant", EVENT, t_ns


def outboxes(session: Session) -> dict[str, Outbox]:
    """Return the publisher of each process of the dive, which publishes its status too."""
    kinds: dict[str, set[type[messages.Message]]] = {node: {messages.NodeStatus} for node in NODES}
    for node, message, _ in dive(EVENT.t_ns / S):
        kinds.setdefault(node, {messages.NodeStatus}).add(type(message))
    return {node: Outbox(session, node=node, epoch=EPOCH, kinds=tuple(of)) for node, of in kinds.items()}


def record(path: Path, until_s: float = 20.0) -> Path:
    """Write the dive as a recording."""
    metadata = {"mode": "services", "seed": "3", "config/vehicle.toml": VEHICLE, "scenario.toml": 'title = "made up"\n'}
    with RunWriter(path, start_ns=-S, metadata=metadata, flush_s=None) as writer:
        sequences: dict[type, int] = {}
        for node, signal, t_ns in dive(until_s):
            sequence = sequences[type(signal)] = sequences.get(type(signal), -1) + 1
            writer.write(node, signal, Header(epoch=EPOCH, sequence=sequence), t_ns)
    return path
