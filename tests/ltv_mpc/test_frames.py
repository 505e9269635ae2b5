"""Rotations against scipy, an independent implementation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ltv_mpc import frames

components = st.floats(-1.0, 1.0)
vectors = st.tuples(components, components, components).map(np.array)
lengths = st.sampled_from([0.0, 1e-12, 1e-6, 9.9e-5, 1.01e-4, 0.1, 1.0, 2.5, 2.7, 3.1, math.pi - 1e-5, math.pi - 1e-9])


def of_length(vector, length):
    norm = np.linalg.norm(vector)
    return vector * (length / norm) if norm > 1e-3 else np.array([0.0, length, 0.0])


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_rotation_is_heading_then_pitch_then_roll(roll, pitch, heading):
    R = frames.rotation(roll, pitch, heading)
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", [heading, pitch, roll]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(frames.roll_pitch_heading(R), [roll, pitch, heading], atol=1e-12)


@given(vectors, lengths)
def test_exp_and_log_agree_with_scipy_and_with_each_other(vector, length):
    phi = of_length(vector, length)
    R = frames.rotation_exp(phi)
    np.testing.assert_allclose(R, Rotation.from_rotvec(phi).as_matrix(), atol=2e-15)
    # Near half a turn the axis is known to the square root of the rounding, the rotation itself is not less exact.
    np.testing.assert_allclose(frames.rotation_log(R), phi, atol=1e-15 if length < 2e-4 else 1e-7)
    np.testing.assert_allclose(frames.rotation_exp(frames.rotation_log(R)), R, atol=2e-15)


def test_half_turns_have_a_logarithm():
    for axis in np.eye(3):
        R = frames.rotation_exp(math.pi * axis)
        np.testing.assert_allclose(frames.rotation_exp(frames.rotation_log(R)), R, atol=2e-15)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(frames.skew(a) @ b, np.cross(a, b), atol=1e-15)


@given(st.floats(-50.0, 50.0))
def test_wrapped_angles_lie_within_half_a_turn_and_point_the_same_way(angle):
    wrapped = frames.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi == frames.wrap_angle(-math.pi)
    assert math.isclose(math.cos(wrapped - angle), 1.0, abs_tol=1e-12)
    assert abs(math.sin(wrapped - angle)) < 1e-13


@pytest.mark.parametrize("angle", [math.pi, -3.0, 0.0, 1e-300, -1e-300, 3.0])
def test_an_angle_within_half_a_turn_is_left_alone(angle):
    assert frames.wrap_angle(angle) == angle


def test_the_earth_turns_up_at_the_north_pole_and_north_at_the_equator():
    np.testing.assert_allclose(frames.earth_rate(math.pi / 2), [0.0, 0.0, -frames.EARTH_RATE_RADPS], atol=1e-20)
    np.testing.assert_allclose(frames.earth_rate(0.0), [frames.EARTH_RATE_RADPS, 0.0, 0.0], atol=1e-20)
    # A sidereal day: 23 h 56 min 4.1 s
    assert math.isclose(2 * math.pi / frames.EARTH_RATE_RADPS, 86_164.1, rel_tol=1e-6)
