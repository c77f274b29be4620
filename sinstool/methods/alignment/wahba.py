"""Wahba's problem: the rotation that best maps one set of vectors to another.

Minimise ``1/2 sum a_k |beta_k - C alpha_k|^2`` over rotations C, given only the attitude
profile matrix ``B = sum a_k beta_k alpha_k^T``; eq. (5) of Qu et al. All solvers work on
stacks of matrices.

References
----------
.. [1] F. L. Markley, D. Mortari, "Quaternion attitude estimation using vector observations",
   J. Astronautical Sciences 48(2-3), 2000, 359-380.
.. [2] M. D. Shuster, S. D. Oh, "Three-axis attitude determination from vector observations",
   J. Guidance and Control 4(1), 1981, 70-77.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.rotation import multiply, to_dcm

# Signs of B's columns that turn the problem by half a turn about each axis, and none.
_HALF_TURNS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
_QUEST_STEPS = 20


def _profiles(profile: ArrayLike) -> FloatArray:
    b = np.asarray(profile, dtype=np.float64)
    if b.ndim < 2 or b.shape[-2:] != (3, 3):
        raise ValueError(f"Expected `profile` to have shape (..., 3, 3), got {b.shape}.")
    size = np.linalg.norm(b, axis=(-2, -1))
    if not np.all(np.isfinite(size)) or np.any(size == 0.0):
        raise ValueError("Found an attitude profile matrix that is zero or not finite.")
    return np.asarray(b / size[..., None, None])


def solve_svd(profile: ArrayLike) -> FloatArray:
    """Rotation by singular value decomposition.

    Parameters
    ----------
    profile : array_like, shape (..., 3, 3)
        B.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``C = U diag(1, 1, det U det V) V^T``; section "SVD method" of [1]_ of the module. With
        nearly parallel vectors its error grows like 1 / angle, that of the others like the
        square of it. Where B has rank 1, C is one of many.

    Raises
    ------
    ValueError
        If the shape is wrong or a matrix is zero or not finite.
    """
    u, _, vt = np.linalg.svd(_profiles(profile))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[..., :, 2] *= sign[..., None]
    return np.asarray(u @ vt)


def singular_values(profile: ArrayLike) -> FloatArray:
    """Singular values ``s1 >= s2 >= |s3|`` with the sign of det B on the last, (..., 3)."""
    b = np.asarray(profile, dtype=np.float64)
    s = np.linalg.svd(b, compute_uv=False)
    s[..., 2] *= np.where(np.linalg.det(b) < 0.0, -1.0, 1.0)
    return np.asarray(s)


def _davenport_matrix(b: FloatArray) -> FloatArray:
    k = np.empty((*b.shape[:-2], 4, 4))
    trace = np.trace(b, axis1=-2, axis2=-1)
    z = _axial(b)
    k[..., 0, 0] = trace
    k[..., 0, 1:] = z
    k[..., 1:, 0] = z
    k[..., 1:, 1:] = b + np.swapaxes(b, -1, -2) - trace[..., None, None] * np.eye(3)
    return k


def _axial(b: FloatArray) -> FloatArray:
    """Sum of ``a_k alpha_k x beta_k``."""
    return np.stack(
        [b[..., 2, 1] - b[..., 1, 2], b[..., 0, 2] - b[..., 2, 0], b[..., 1, 0] - b[..., 0, 1]],
        axis=-1,
    )


def solve_davenport(profile: ArrayLike) -> FloatArray:
    """Rotation by the eigenvector of Davenport's 4x4 matrix ("q method" of [1]_ of the module).

    Parameters, return value and errors are those of :func:`solve_svd`.
    """
    _, vectors = np.linalg.eigh(_davenport_matrix(_profiles(profile)))
    return to_dcm(vectors[..., :, 3])


def solve_quest(profile: ArrayLike) -> FloatArray:
    """Rotation by QUEST, with sequential rotations.

    Parameters
    ----------
    profile : array_like, shape (..., 3, 3)
        B.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        C.

    Raises
    ------
    ValueError
        If the shape is wrong or a matrix is zero or not finite.

    Notes
    -----
    The largest eigenvalue by Newton's method on ``(l^2 - |B|^2)^2 - 8 l det B - 4 |adj B|^2``,
    eqs. (15) and (20) of [1]_ of the module, from above and only downward; then
    Shuster's quaternion [2]_. Near half a turn that quaternion is small, and the problem is
    turned by half a turn about an axis first: of the four versions the largest is taken.
    """
    b = _profiles(profile)
    det = np.linalg.det(b)
    adj2 = np.sum(_adjugate(b) ** 2, axis=(-2, -1))
    value = np.full(b.shape[:-2], np.sqrt(3.0))  # |B| is 1: no eigenvalue is larger
    for _ in range(_QUEST_STEPS):
        excess = value * value - 1.0
        slope = 4.0 * value * excess - 8.0 * det
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (excess * excess - 8.0 * value * det - 4.0 * adj2) / slope
        # Upward or without slope there is only rounding left.
        step = np.where((slope > 0.0) & (step > 0.0), step, 0.0)
        value = value - step
        if np.all(step <= 1e-15):
            break
    turned = b[..., None, :, :] * _HALF_TURNS[:, None, :]
    q = _shuster_quaternion(turned, value[..., None])
    size = np.linalg.norm(q, axis=-1)
    best = np.argmax(np.where(np.isfinite(size), size, 0.0), axis=-1)
    chosen = np.take_along_axis(q, best[..., None, None], axis=-2)[..., 0, :]
    with np.errstate(invalid="ignore"):
        chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    # C diag(signs) solves the turned problem, and the signs are a half turn about one axis.
    return to_dcm(multiply(chosen, np.eye(4)[best]))


def _shuster_quaternion(b: FloatArray, value: FloatArray) -> FloatArray:
    s = b + np.swapaxes(b, -1, -2)
    sigma = np.trace(b, axis1=-2, axis2=-1)
    kappa = np.trace(_adjugate(s), axis1=-2, axis2=-1)
    z = _axial(b)
    alpha = value**2 - sigma**2 + kappa
    first = (s @ z[..., None])[..., 0]
    second = (s @ first[..., None])[..., 0]
    vector = alpha[..., None] * z + (value - sigma)[..., None] * first + second
    scalar = (value + sigma) * alpha - np.linalg.det(s)
    return np.concatenate([scalar[..., None], vector], axis=-1)


def _adjugate(m: FloatArray) -> FloatArray:
    """Transposed cofactors; rows of the cofactors are cross products of the rows."""
    r0, r1, r2 = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    return np.stack([np.cross(r1, r2), np.cross(r2, r0), np.cross(r0, r1)], axis=-1)


def solve_triad(
    beta_1: ArrayLike, beta_2: ArrayLike, alpha_1: ArrayLike, alpha_2: ArrayLike
) -> FloatArray:
    """Rotation from two vectors, of which the first is matched exactly (TRIAD).

    Parameters
    ----------
    beta_1, beta_2, alpha_1, alpha_2 : array_like, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``beta = C alpha``; [2]_ of the module. NaN where the vectors are parallel.
    """
    return _triad_frame(beta_1, beta_2) @ np.swapaxes(_triad_frame(alpha_1, alpha_2), -1, -2)


def _triad_frame(first: ArrayLike, second: ArrayLike) -> FloatArray:
    v1 = np.asarray(first, dtype=np.float64)
    normal = np.cross(v1, np.asarray(second, dtype=np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        t1 = v1 / np.linalg.norm(v1, axis=-1, keepdims=True)
        t2 = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([t1, t2, np.cross(t1, t2)], axis=-1)


SOLVERS = {"svd": solve_svd, "quest": solve_quest, "davenport": solve_davenport}
