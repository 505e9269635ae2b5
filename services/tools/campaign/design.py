"""Design points of a campaign: the combinations of the values of its varied keys."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from msgspec import inspect
from scipy.stats import qmc

from ltv_mpc.messages import Array
from services.tools.campaign.file import Campaign, Choices, Range
from services.tools.campaign.keys import Value, kind_of

Point: TypeAlias = dict[str, Value]


def points(campaign: Campaign) -> list[Point]:
    """List the points of ``vary``, each combined with all of ``cross``, the last key fastest; the order is
    reproducible.
    """
    crossed = [dict(zip(campaign.cross, values, strict=True)) for values in itertools.product(*campaign.cross.values())]
    return [{**laid, **more} for laid in _laid(campaign) for more in crossed]


def _laid(campaign: Campaign) -> list[Point]:
    keys, over = list(campaign.vary), list(campaign.vary.values())
    if campaign.design.kind == "grid":
        lists = [values for values in over if not isinstance(values, Range)]
        return [dict(zip(keys, values, strict=True)) for values in itertools.product(*lists)]
    return [_point(keys, over, shares) for shares in _shares(campaign, len(keys))]


def _shares(campaign: Campaign, dimensions: int) -> Array:
    """Draw the positions of the points in their ranges, (points, dimensions), each in 0 .. 1."""
    design = campaign.design
    if design.kind == "random":
        drawn: Array = np.random.default_rng(design.seed).random((design.points, dimensions))
        return drawn
    with warnings.catch_warnings():  # that another number than a power of two fills less evenly: the file's choice
        warnings.simplefilter("ignore", UserWarning)
        even: Array = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(design.seed)).random(design.points)
    return even


def _point(keys: Sequence[str], over: Sequence[Choices | Range], shares: Array) -> Point:
    return {key: value_at(key, values, float(share)) for key, values, share in zip(keys, over, shares, strict=True)}


def value_at(key: str, over: Choices | Range, share: float) -> Value:
    """Return the value at position ``share``, 0 .. 1, of a range or list."""
    if isinstance(over, Range):
        number = over.interpolate(share)
        return round(number) if isinstance(kind_of(key), inspect.IntType) else number
    return over[min(int(share * len(over)), len(over) - 1)]
