"""Quaternions against SciPy's rotations."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from scipy.spatial.transform import Rotation

from maax_mjx.physics.rotation import conjugate, multiply, rotate

N = 1000


def drawn(n):
    """N rotations, uniform over all: SciPy's, and the quaternions with w first, of either sign."""
    rotations = Rotation.random(N, random_state=seeds.seed(n))
    signs = seeds.rng(n).choice([-1, 1], (N, 1))
    return rotations, jnp.asarray(signs * rotations.as_quat()[:, [3, 0, 1, 2]], jnp.float32)


def close_rotations(quat, want):
    """Whether they are the same turns: q and -q are one."""
    quat = np.asarray(quat, float)
    np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1, atol=1e-6)
    got = Rotation.from_quat(quat.reshape(-1, 4)[:, [1, 2, 3, 0]])
    np.testing.assert_allclose(got.as_matrix(), want.as_matrix(), atol=2e-6)


def test_the_opposite_turn():
    rotations, quat = drawn(0)
    close_rotations(conjugate(quat), rotations.inv())


def test_the_product_is_the_second_turn_then_the_first():
    (a, quat_a), (b, quat_b) = drawn(0), drawn(1)
    close_rotations(multiply(quat_a, quat_b), a * b)


def test_vectors_are_turned():
    rotations, quat = drawn(2)
    vectors = seeds.rng(3).normal(size=(N, 3))
    np.testing.assert_allclose(rotate(quat, jnp.asarray(vectors, jnp.float32)), rotations.apply(vectors), atol=5e-6)


@pytest.mark.parametrize("lead", [(), (4,), (2, 5)], ids=str)
def test_leading_axes_broadcast(lead):
    rotations, quat = drawn(4)
    vectors = seeds.rng(5).normal(size=(*lead, 3))
    got = rotate(quat[0], jnp.asarray(vectors, jnp.float32))
    np.testing.assert_allclose(got, rotations[0].apply(vectors.reshape(-1, 3)).reshape(*lead, 3), atol=5e-6)
    n = int(np.prod(lead))
    several = quat[:n].reshape(*lead, 4)
    close_rotations(multiply(quat[0], several), rotations[0] * rotations[:n])


def test_angles_are_those_about_the_axis():
    """A quarter turn about z takes x to y, written down."""
    half = np.sqrt(0.5)
    quarter = jnp.array([half, 0.0, 0.0, half])
    np.testing.assert_allclose(rotate(quarter, jnp.array([1.0, 0.0, 0.0])), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(multiply(quarter, quarter), [0, 0, 0, 1], atol=1e-6)
