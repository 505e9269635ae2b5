"""Change of a vehicle's velocity in a recording, from its beams: how fast does the vehicle turn and accelerate?

A glider changes its velocity by centimetres per second from ensemble to ensemble, a vehicle that turns by metres, and
between two turns hardly. So the random walk of the filter has an intensity of its own in each step. With u the velocity
relative to the water in an ensemble, the median over its cells,

    q_k^2 = (|u_k - u_(k-1)|^2 / 2 - s_k^2 - s_(k-1)^2) / dt,   s^2 the variance of the noise of u in one axis

The median of n cells has pi / 2 times the variance of their mean. No error of a position enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.noise import BeamNoise
from ltv_mpc.localisation.recorded_dive.screening import Mask
from ltv_mpc.messages import Array


def velocity_changes(
    ensembles: Sequence[BeamEnsemble], masks: Sequence[Mask], noise: BeamNoise, least_mps_per_rts: float
) -> Array:
    """Return the intensity (N,) of the velocity's random walk (m/s per square root of s) in the step to each ensemble.

    Parameters
    ----------
    ensembles : the dive.
    masks : usable cells (4, cells) of each ensemble.
    noise : beam noise of the recording.
    least_mps_per_rts : smallest intensity.
    """
    changes = np.full(len(ensembles), least_mps_per_rts)
    before: tuple[int, Array, float] | None = None
    for k, (ensemble, mask) in enumerate(zip(ensembles, masks, strict=True)):
        cells = mask.all(axis=0)
        if not cells.any():
            continue
        inverse = np.linalg.pinv(ensemble.direction)[:2]
        through_water = np.median(inverse @ ensemble.velocity_mps[:, cells], axis=1)
        of_beam = float(np.mean(noise.sd_mps(ensemble.settings)[cells] ** 2))
        variance = 0.5 * math.pi * of_beam * 0.5 * float((inverse**2).sum()) / int(cells.sum())
        if before is not None:
            last, velocity, noise_before = before
            dt = 1e-9 * (ensemble.t_ns - ensembles[last].t_ns)
            square = float(((through_water - velocity) ** 2).sum()) / 2.0 - variance - noise_before
            changes[last + 1 : k + 1] = np.maximum(changes[last + 1 : k + 1], math.sqrt(max(square, 0.0) / dt))
        before = k, through_water, variance
    return changes
