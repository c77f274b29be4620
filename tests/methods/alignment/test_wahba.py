import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core import rotation
from sinstool.methods.alignment.wahba import (
    SOLVERS,
    singular_values,
    solve_davenport,
    solve_quest,
    solve_svd,
    solve_triad,
)


def angle_deg(a, b):
    """From the difference of matrices: no loss near zero."""
    return np.rad2deg(2.0 * np.arcsin(np.linalg.norm(a - b, axis=(-2, -1)) / np.sqrt(8.0)))


def problems(count=3000, seed=1):
    rng = np.random.default_rng(seed)
    q = rotation.normalise(rng.normal(size=(count, 4)))
    half, few = count // 5, count // 30
    q[:half, 0] = 0.0  # half turns about any axis
    q[:few, 1:3] = 0.0
    q[half : half + few] = rotation.exp(1e-9 * rng.normal(size=(few, 3)))
    q = rotation.normalise(q)
    c = rotation.to_dcm(q)
    alpha = rng.normal(size=(count, 6, 3))
    beta = np.einsum("nij,nkj->nki", c, alpha)
    beta[::2] += 0.1 * rng.normal(size=beta[::2].shape)
    profile = np.einsum("nki,nkj->nij", beta, alpha)
    return profile * 10.0 ** rng.uniform(-3, 11, size=(count, 1, 1)), alpha, beta, c


def test_solvers_agree():
    profile, _, _, c = problems()
    svd = solve_svd(profile)
    assert angle_deg(solve_davenport(profile), svd).max() < 2e-12
    assert angle_deg(solve_quest(profile), svd).max() < 2e-12
    assert angle_deg(svd, c)[1::2].max() < 1e-12  # without noise
    np.testing.assert_allclose(np.linalg.det(svd), 1.0, atol=1e-13)


def test_against_scipy():
    profile, alpha, beta, _ = problems(40, seed=2)
    for k in range(40):
        other, _ = Rotation.align_vectors(beta[k], alpha[k])
        assert angle_deg(solve_svd(profile[k]), other.as_matrix()) < 1e-10


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_rotation_is_better(seed):
    rng = np.random.default_rng(seed)
    profile = rng.normal(size=(3, 3))  # any, also of negative determinant
    near = rotation.exp(10.0 ** rng.uniform(-3, 0.4, size=(50, 1)) * rng.normal(size=(50, 3)))
    for solver in SOLVERS.values():
        c = solver(profile)
        best = np.trace(c @ profile.T)
        others = np.einsum("nij,ij->n", rotation.to_dcm(near) @ c, profile)
        assert np.all(others <= best + 1e-12)
        assert best == pytest.approx(singular_values(profile).sum(), abs=1e-12)


def test_nearly_parallel_vectors():
    # Of two vectors 1e-6 rad apart only SVD finds the turn about them.
    errors = {"svd": [], "davenport": [], "quest": []}
    pair = np.array([[1.0, 0.0, 0.0], [np.cos(1e-6), np.sin(1e-6), 0.0]])
    for c in rotation.to_dcm(rotation.normalise(np.random.default_rng(4).normal(size=(60, 4)))):
        profile = (pair @ c.T).T @ pair
        errors["svd"].append(angle_deg(solve_svd(profile), c))
        errors["davenport"].append(angle_deg(solve_davenport(profile), c))
        errors["quest"].append(angle_deg(solve_quest(profile), c))
    assert max(errors["svd"]) < 1e-6
    assert max(errors["davenport"]) > 1e-3
    assert max(errors["quest"]) > 1e-3


def test_singular_values_have_the_sign_of_the_determinant():
    profile, *_ = problems(50)
    profile[::2] *= -1.0
    s = singular_values(profile)
    np.testing.assert_allclose(s.prod(axis=-1), np.linalg.det(profile), rtol=1e-9)
    assert np.all(s[:, 0] >= s[:, 1]) and np.all(s[:, 1] >= np.abs(s[:, 2]))


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)
def test_impossible(solver):
    for wrong in (np.zeros((3, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="zero or not finite"):
            solver(wrong)
    with pytest.raises(ValueError, match="shape"):
        solver(np.eye(4))


def test_triad_matches_the_first_vector():
    rng = np.random.default_rng(5)
    c = rotation.to_dcm(rotation.normalise(rng.normal(size=(20, 4))))
    a1, a2 = rng.normal(size=(2, 20, 3))
    b1 = np.einsum("nij,nj->ni", c, a1)
    b2 = np.einsum("nij,nj->ni", c, a2)
    assert angle_deg(solve_triad(b1, 3.0 * b2, a1, a2), c).max() < 1e-12
    wrong = solve_triad(b1, b2 + 0.1, a1, a2)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", wrong, a1), b1, atol=1e-13)
    assert angle_deg(wrong, c).min() > 1e-3
    assert np.isnan(solve_triad(b1[0], 2.0 * b1[0], a1[0], 2.0 * a1[0])).all()
