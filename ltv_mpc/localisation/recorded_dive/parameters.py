"""What the filter of a recorded dive assumes: one set for every instrument and every dive.

Each number stands with where it is from: the kind of vehicle, the design's figures for sea and instrument, data sheets,
and what a recording says of its instrument without a position: error velocities and vertical velocities by cell. None
is fitted to the position error of a dive. The beams' noise is not here: ``noise.py`` takes it from each recording.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

Positive: TypeAlias = Annotated[float, Meta(gt=0, le=1e6)]
Sd: TypeAlias = Annotated[float, Meta(ge=0, le=10)]


class DiveParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All 1 sigma, SI."""

    # Velocity over ground as a random walk, wide enough never to hold a vehicle back: 6 cm/s in the 4 s of an ensemble
    # is 0.3 m/s turned by 3 deg/s, or a swell; shear of 0.02 per second at 0.14 m/s of descent is a fifth of it.
    velocity_change_mps_per_rts: Positive = 0.03
    # Before the first fix: no glider or survey vehicle is faster.
    velocity_sd_mps: Positive = 2.0

    # c = m + s(z): what all depths share is a tide of a shelf sea; s is as strong as the design's sweep of measured
    # profiles goes (0.03 to 0.1 m/s, 6 to 16 m), so that cells speak for themselves and not for their neighbours.
    water_mean_sd_mps: Positive = 0.5
    water_sd_mps: Positive = 0.1
    water_correlation_length_m: Positive = 10.0
    # Internal waves and eddies of 3 cm/s that change in 15 minutes: sqrt(2 x 0.03^2 / 900).
    water_change_mps_per_rts: Sd = 0.0015

    # Bias of a beam: a constant (data sheets: some mm/s and 0.3 %; the design's 5 mm/s) ...
    beam_bias_sd_mps: Sd = 0.005
    # ... a part that varies with range (error velocities and vertical velocities by cell differ by 2 to 4 mm/s) ...
    range_bias_sd_mps: Sd = 0.003
    range_bias_length_m: Positive = 5.0
    # ... and one near the face, by ringing and the flow about the hull, that falls with exp(-range / length): 1.7 and
    # 1.0 cm/s in the first two cells of 2 m at 30 deg. Known of such instruments: 1 to 2 cm/s in the near cells.
    near_bias_sd_mps: Sd = 0.04
    near_bias_length_m: Positive = 4.0
    # Biases go with speed and attitude, which a vehicle keeps for minutes.
    bias_tau_s: Positive = 300.0
    # Of one ensemble of pings, north and east: error velocities of bottom track of 3 to 7 mm/s, rounded up because
    # bottom and water pings take turns.
    bottom_sd_mps: Positive = 0.01

    # What is used at all: the usual half of the pings, and the gate of the whole project.
    min_good_share: Annotated[float, Meta(gt=0, le=1)] = 0.5
    gate_probability: Annotated[float, Meta(gt=0.5, lt=1)] = 0.999
    # A dive ends at a longer gap: the vehicle is at the surface, or the clock was set.
    longest_gap_s: Positive = 120.0
