"""The colours of every figure come from one file, and remain different for the three kinds of colour blindness."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from ltv_mpc.messages import Array
from services.reporting.plots import palette

MEANT = (palette.TRUTH, palette.ESTIMATE, palette.REFERENCE, palette.PORT, palette.STARBOARD, palette.CURRENT)

EVERY_MEANING = tuple(colour for name, colour in vars(palette).items() if name.isupper() and isinstance(colour, str))


VISION = {
    "normal": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "protanopia": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)),
    "deuteranopia": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)),
    "tritanopia": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)),
}
"""Matrices on linear sRGB at full severity: Machado, Oliveira and Fernandes, A Physiologically-based Model for
Simulation of Color Vision Deficiency, IEEE TVCG 15 (2009).
"""

XYZ = np.array([[0.41246, 0.35758, 0.18044], [0.21267, 0.71515, 0.07217], [0.01933, 0.11919, 0.95030]])

LEAST = 9.0
"""Least distance of two colours in CIELAB (1976). A difference of 2.3 is just visible where the two areas touch."""

ANOTHER = 20.0
"""Least distance of the colour of a run from one with a meaning: a reader does not take one for the other even if the
two are in different plots.
"""


def lab(colour: str, vision: str) -> Array:
    """Return CIELAB coordinates (3,) of a colour as seen with this vision, for the white of a screen (D65)."""
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    relative = XYZ @ (np.array(VISION[vision]) @ linear).clip(0.0, 1.0) / XYZ.sum(axis=1)
    f = np.where(relative > 216 / 24389, np.cbrt(relative), (24389 / 27 * relative + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("colours", [MEANT, palette.RUNS], ids=["meanings", "runs"])
@pytest.mark.parametrize("vision", VISION)
def test_colours_remain_different_for_each_kind_of_colour_blindness(vision, colours, dark) -> None:
    shown = [palette.DARK[colour] if dark else colour for colour in colours]
    for one, other in itertools.combinations(shown, 2):
        assert np.linalg.norm(lab(one, vision) - lab(other, vision)) > LEAST, (one, other)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_colour_of_a_run_is_near_one_with_a_meaning(dark: bool) -> None:
    assert len(EVERY_MEANING) > 10
    for run, meant in itertools.product(palette.RUNS, EVERY_MEANING):
        one, other = (palette.DARK[colour] if dark else colour for colour in (run, meant))
        assert np.linalg.norm(lab(one, "normal") - lab(other, "normal")) > ANOTHER, (one, other)
