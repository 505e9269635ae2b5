"""Which cells of an ensemble are water: enough good pings, above the sea bed's side lobes, below the surface.

Sea bed     the echo falls with range until it rises by 9 dB within two cells: the bottom of that beam, at r_i.
            Of a flat bottom, with u_d the beams' down components, which add up to 4 cos(beam angle) cos(tilt) however
            the instrument is mounted:
                altitude  h = sum(u_d) / sum(1 / r_i),   cos(beam i from the vertical) = h / r_i
            Side lobes straight down come back at slant range h, so beam i is water to the depth h cos_i; one cell less
            for the length of the pulse; the beam that lies flattest counts for all, because earth coordinates mix them.
            A beam without a rise sees no bottom: its range is that of the last cell. With fewer than two rises nothing
            is cut. Looking up, the same of the surface.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.pd0.records import Settings

RISE_COUNTS = 20.0
"""9 dB at 0.45 dB a count: scattering layers rise by less, a sea bed by 15 to 25 dB."""
FIRST = 3
"""Nearer cells may ring."""


def usable(ensemble: BeamEnsemble, settings: Settings, min_good_share: float) -> npt.NDArray[np.bool_]:
    """(4, cells)."""
    there = np.isfinite(ensemble.velocity_mps) & (ensemble.good >= min_good_share)
    in_water = ensemble.depth_m + ensemble.below_m > 0
    reach = np.abs(ensemble.below_m) < reach_m(ensemble, settings)
    result: npt.NDArray[np.bool_] = there & in_water & reach
    return result


def reach_m(ensemble: BeamEnsemble, settings: Settings) -> float:
    """Vertical distance to which the water is free of the bottom's echo; infinite where no bottom is seen."""
    if ensemble.echo is None or settings.cells <= FIRST + 2:
        return math.inf
    echo = ensemble.echo
    rises = echo[:, FIRST:] - echo[:, FIRST - 2 : -2] >= RISE_COUNTS
    seen = rises.any(axis=1)
    if seen.sum() < 2:
        return math.inf
    r = np.where(seen, ensemble.range_m[FIRST + np.argmax(rises, axis=1)], ensemble.range_m[-1])
    h = float(np.abs(ensemble.direction[:, 2].sum()) / np.sum(1 / r))
    return h * h / float(r.max()) - settings.cell_m
