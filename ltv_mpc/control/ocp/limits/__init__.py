"""Limits of the problem, one file each: its rows, and what it costs to exceed it.

    box      smallest and largest thrust               hard; the line search keeps it exactly, by clipping
    slew     largest change of thrust                  hard; likewise
    motion   surge and yaw rate                        soft
    fence    zones, obstacles and corridor (last rows) soft; rows only near to them

``add(p, lin, target, o)`` adds the rows of all knots to a problem, in the places that the file names; arguments as in
``ocp/terms``.
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.limits import box, motion, slew
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import COMMANDS, Objective
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

LIMITS = (box, slew, motion)
"""All limits with rows at every knot."""

ROWS = 6
"""Rows of these limits at a knot: box and slew of port and starboard, then surge and yaw rate."""


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the rows of ``LIMITS`` to a problem.

    Parameters
    ----------
    p : problem.
    lin, target, o : as in ``ocp/terms``.
    """
    box.add(p, lin, target, o)
    slew.add(p, lin, target, o)
    motion.add(p, lin, target, o)


def names(scale: Array) -> list[tuple[str, float, str]]:
    """Return name, scale and unit of the rows of ``LIMITS`` at a knot: a row times its scale has the unit.

    Parameters
    ----------
    scale : (12,) what is 1 in states and inputs (ocp/assembly.py).
    """
    sides = ("port", float(scale[COMMANDS])), ("starboard", float(scale[COMMANDS + 1]))
    return [
        *((f"limit of {side}", F, "N") for side, F in sides),
        *((f"slew of {side}", F, "N") for side, F in sides),
        ("limit of surge", float(scale[2]), "m/s"),
        ("limit of yaw rate", float(scale[5]), "rad/s"),
    ]
