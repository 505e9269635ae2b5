"""Screening of ADCP cells: enough good pings, above the side lobes of the sea bed, below the surface.

Sea bed     The echo falls with range until it rises by 9 dB within two cells: the bottom in that beam, at range r_i.
            For a flat bottom, with u_d the down components of the beams (their sum is 4 cos(beam angle) cos(tilt) for
            any mounting):
                altitude  h = sum(u_d) / sum(1 / r_i),   cos(beam i from the vertical) = h / r_i
            Side lobes straight down return at slant range h, so beam i sees water down to the depth h cos_i; one cell
            less for the length of the pulse. The flattest beam counts for all, because earth coordinates mix the beams.
            A beam without a rise sees no bottom: its range is that of the last cell. With fewer than two rises nothing
            is cut. Looking up, the same applies to the surface.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.localisation.pd0.beams import BeamEnsemble

Mask: TypeAlias = npt.NDArray[np.bool_]

RISE_COUNTS = 20.0
"""Smallest rise of a sea-bed echo: 9 dB at 0.45 dB a count. Scattering layers rise by less, a sea bed by 15 to 25."""

FIRST = 3
"""First cell searched for the sea bed. Nearer cells may ring."""


def usable(ensemble: BeamEnsemble, min_good_share: float) -> Mask:
    """Return the mask of usable cells, (4, cells).

    Parameters
    ----------
    ensemble : beam velocities, depths and echoes.
    min_good_share : smallest share of good pings.
    """
    there = np.isfinite(ensemble.velocity_mps) & (ensemble.good >= min_good_share)
    in_water = ensemble.depth_m + ensemble.below_m > 0
    reach = np.abs(ensemble.below_m) < reach_m(ensemble)
    result: Mask = there & in_water & reach
    return result


def reach_m(ensemble: BeamEnsemble) -> float:
    """Return the vertical distance without side-lobe echoes of the bottom (m); infinite if no bottom is seen.

    Parameters
    ----------
    ensemble : echoes by beam and cell.
    """
    settings = ensemble.settings
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
