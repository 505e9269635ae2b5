"""Parameters of the filter for recorded dives: one set for all instruments and dives.

Each number has its source beside it: the kind of vehicle, the design's figures for sea and instrument, data sheets, and
statistics of recordings that need no position (error velocities and vertical velocities by cell). None is fitted to the
position error of a dive. Beam noise is not a parameter: ``noise.py`` estimates it from each recording.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

Positive: TypeAlias = Annotated[float, Meta(gt=0, le=1e6)]
Sd: TypeAlias = Annotated[float, Meta(ge=0, le=10)]


class DiveParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations (1 sigma) and lengths, SI units."""

    # Velocity over ground is a random walk: 6 cm/s in the 4 s of an ensemble is 0.3 m/s turned by 3 deg/s, or a swell;
    # a shear of 0.02 per second at a descent of 0.14 m/s is a fifth of it. The least: ``filter.py`` estimates
    # what a vehicle does that is faster or turns more.
    velocity_change_mps_per_rts: Positive = 0.03
    # Before the first fix: no glider or survey vehicle is faster.
    velocity_sd_mps: Positive = 2.0

    # c = m + s(z): m is a tide of a shelf sea. s has the upper end of the design's range of measured profiles (0.03 to
    # 0.1 m/s, 6 to 16 m), so that a cell has little influence on its neighbours.
    water_mean_sd_mps: Positive = 0.5
    water_sd_mps: Positive = 0.1
    water_correlation_length_m: Positive = 10.0
    # Internal waves and eddies of 3 cm/s that change in 15 minutes: sqrt(2 x 0.03^2 / 900).
    water_change_mps_per_rts: Sd = 0.0015
    # Change with the distance run, which the filter does not model: its covariance is widened by it. 0 in water that is
    # horizontally uniform; ``uniformity.py`` estimates it.
    water_change_mps_per_rtm: Sd = 0.0

    # Bias of a beam: a constant (data sheets: some mm/s and 0.3 %; the design's 5 mm/s) ...
    beam_bias_sd_mps: Sd = 0.005
    # ... a part that varies with range (error velocities and vertical velocities by cell differ by 2 to 4 mm/s) ...
    range_bias_sd_mps: Sd = 0.003
    range_bias_length_m: Positive = 5.0
    # ... and one near the transducer, from ringing and the flow around the hull, that falls with exp(-range / length):
    # 1.7 and 1.0 cm/s in the first two cells of 2 m at 30 deg. Typical of such instruments: 1 to 2 cm/s near the face.
    near_bias_sd_mps: Sd = 0.04
    near_bias_length_m: Positive = 4.0
    # Biases depend on speed and attitude, which a vehicle keeps for minutes.
    bias_tau_s: Positive = 300.0
    # Bottom track of one ensemble, north and east: its error velocities are 3 to 7 mm/s, rounded up because bottom and
    # water pings alternate.
    bottom_sd_mps: Positive = 0.01

    # Screening: the usual half of the pings must be good; the gate has the probability of the estimator's.
    min_good_share: Annotated[float, Meta(gt=0, le=1)] = 0.5
    gate_probability: Annotated[float, Meta(gt=0.5, lt=1)] = 0.999
    # A dive ends at a longer gap: the vehicle is at the surface, or its clock was set.
    longest_gap_s: Positive = 120.0
