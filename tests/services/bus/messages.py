"""One message of every kind that travels, of some two: what tests encode, decode and damage."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ltv_mpc import messages
from services.bus.schema import Schema, schema
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, from_map
from tests.ltv_mpc.reports import report
from tests.services.words import running_clock

HEADER = Header(epoch=2**48 - 1, sequence=7, sent_monotonic_us=123_456_789)
TRIPLE = (0.1, -2.5e-17, 3.0)

PROFILE = messages.CurrentProfile(
    depth_m=np.arange(70.0), north_mps=0.1 * np.sin(np.arange(70.0)), east_mps=np.zeros(70), sd_mps=np.full(70, 0.02)
)
CONTROLLER_STATE = messages.ControllerState(
    t_ns=10**9,
    authority=messages.Authority.CONTROLLER,
    reference_toml='kind = "hold"',
    reference_start=messages.ReferenceStart(
        t_ns=0, north_m=1.0, east_m=2.0, depth_m=3.0, heading_rad=0.4, velocity_mps=(0.05, -0.02)
    ),
    schedule_s=12.5,
    schedule_rate=0.75,
    progress=0.5,
    depth_integral_N=-3.5,
    plan_delays_ns=(81_000_000, 79_500_001),
    cycle_times_ns=(4_000_000,),
    mission=messages.MissionState(start_t_ns=0, operator_t_ns=10**9),
    disturbance=messages.DisturbanceState(mean=np.linspace(-0.2, 0.2, 12), covariance=1e-4 * np.eye(12)),
    model_products=np.outer([0.5, 1.0, -1.0, 0.1, 0.0, 0.2], [0.5, 1.0, -1.0, 0.1, 0.0, 0.2]),
)
ESTIMATOR_STATE = messages.EstimatorState(
    t_ns=10**9,
    settings_crc=2**32 - 1,
    x=np.array([0.1, -0.2, 0.3]),
    attitude=np.eye(3),
    mounting=np.eye(3),
    covariance=np.array([1.0, 0.1, 2.0, 0.0, 0.2, 3.0]),
    epoch_t_ns=0,
    restarts=1,
)
SHIP = messages.Obstacle(
    id=12, t_ns=4, north_m=10.0, east_m=-5.0, velocity_north_mps=1.0, velocity_east_mps=0.0, radius_m=8.0
)


def filled(described: Schema) -> Any:
    """Return a value that a schema allows; whatever may be left out is there."""
    if "anyOf" in described:
        return next(filled(one) for one in described["anyOf"] if one["type"] != "null")
    if "enum" in described:
        return described["enum"][-1]
    match described["type"]:
        case "integer" | "number" as kind:
            number = 5 if kind == "integer" else 0.1
            return min(max(number, described["minimum"]), described["maximum"])
        case "boolean":
            return True
        case "string":
            return "text"
        case "array":
            one, count = filled(described["items"]), described.get("minItems", 2)
            return [one / (k + 1) if isinstance(one, float) else one for k in range(count)]
    fields = described["properties"] | described.get("patternProperties", {})
    of_map = {} if fields else {"one": filled(described["additionalProperties"])}
    return {name.strip("^$"): filled(field) for name, field in fields.items()} | of_map


def example(kind: type[messages.Message]) -> messages.Message:
    """Return a message with all its fields."""
    return from_map(kind, filled(schema(kind)) | msgspec.structs.asdict(HEADER))[0]


GIVEN: tuple[messages.Message, ...] = (
    report(5, TRIPLE, command_slew_N_per_s=TRIPLE, why="autopilot disarmed; arm it"),
    messages.ImuSamples(
        samples=tuple(
            messages.ImuSample(t_ns=t_ns, interval_ns=10_000_000, angular_rate_radps=TRIPLE, specific_force_mps2=TRIPLE)
            for t_ns in (10_000_000, 20_000_000)
        )
    ),
    messages.TdcpFix(t_ns=0, from_t_ns=-1_000_000_000, north_m=0.01, east_m=0.02),
    messages.BottomTrack(
        t_ns=333_333_333,
        range_m=np.array([12.0, np.nan, 13.0, 12.5]),
        beam_velocity_mps=np.array([0.1, np.nan, 0.3, -0.2]),
    ),
    messages.AdcpPing(
        t_ns=333_333_333,
        range_m=np.arange(1.0, 31.0),
        beam_velocity_mps=np.where(np.arange(120.0) % 7 == 0, np.nan, 0.1).reshape(4, 30),
    ),
    messages.Estimate.at_rest(),
    messages.Estimate(
        t_ns=100_000_000,
        north_m=0.1,
        east_m=0.2,
        heading_rad=0.3,
        yaw_rate_radps=0.4,
        velocity_north_mps=0.5,
        velocity_east_mps=0.6,
        depth_m=20.0,
        velocity_down_mps=0.2,
        altitude_m=12.5,
        covariance=np.diag([25.0, 25.0, 1e-3, 1e-3, 1e-4, 1e-9]),
        current=PROFILE,
    ),
    messages.Plan(
        cycle_t_ns=0,
        t_ns=np.arange(18) * 300_000_000,
        thrust_N=np.linspace(-50.0, 50.0, 54).reshape(18, 3),
        states=np.ones((18, 6)),
        origin=messages.PlanOrigin.SHIFTED,
        solve=messages.Solve(
            status=messages.SolveStatus.ITERATION_LIMIT, iterations=200, primal_residual=3.1e-2, why="limit"
        ),
        why="limit",
        reference_m=(0.0, 0.0),
        depth_limit_m=15.0,
        reference_heading_rad=0.5,
        delivered_N=(1.0, -2.0, 3.0),
    ),
    messages.Obstacles(t_ns=5, obstacles=(SHIP,)),
    messages.FenceInForce(
        t_ns=5,
        hull_radius_m=1.1,
        zones=(
            messages.ZoneInForce(
                label='keep_out[0] "wreck"',
                keep_in=False,
                vertices_m=np.array([[0.0, 0.0], [0.0, 5.0], [5.0, 0.0]]),
                radius_m=0.0,
                margin_m=2.0,
            ),
        ),
        obstacles=(SHIP,),
    ),
    messages.Battery(voltage_V=23.5, remaining=None),
    running_clock(1, vehicle_ns=-1_000_000_000),
    messages.StepRecord(
        node="plant",
        epoch=HEADER.epoch,
        step=0,
        steps=(
            messages.RecordedStep(t_ns=0, cause="grid", inbox=()),
            messages.RecordedStep(
                t_ns=5,
                cause="grid",
                inbox=(messages.InboxEntry(key="plan", epoch=1, sequence=0, crc=2**32 - 1, received_t_ns=5),),
            ),
        ),
    ),
    CONTROLLER_STATE,
    ESTIMATOR_STATE,
)
"""Messages whose fields depend on each other, or whose values a test needs."""

EXAMPLES = (*GIVEN, *(example(kind) for kind in BY_TYPE if kind not in map(type, GIVEN)), example(messages.Battery))
