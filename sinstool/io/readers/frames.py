"""Vectors and quaternions converted between a log's axes and sinstool's.

A log's body axes are FLU (REP-103) or FRD; its world is ENU for FLU logs and NED for FRD logs,
as each convention has it. Inside, body is FRD and the navigation frame NED.
"""

from __future__ import annotations

import numpy as np

# Half turn about x: takes FLU to FRD and back.
_FLIP = np.array([1.0, -1.0, -1.0])
# Where each element of a covariance in ENU stands in NED, row by row, and its sign.
_WORLD = (
    *((4, 1.0), (3, 1.0), (5, -1.0)),
    *((1, 1.0), (0, 1.0), (2, -1.0)),
    *((7, -1.0), (6, -1.0), (8, 1.0)),
)
_SQRT_HALF = np.sqrt(0.5)


def turn_body(vectors: np.ndarray, axes: str) -> np.ndarray:
    """Body vectors from a log's axes to FRD, or back (the turn is its own inverse).

    Parameters
    ----------
    vectors : ndarray, shape (..., 3)
    axes : {'flu', 'frd'}

    Returns
    -------
    ndarray, shape (..., 3)
    """
    return vectors * _FLIP if axes == "flu" else vectors


def enu_to_ned(vectors: np.ndarray) -> np.ndarray:
    """World vectors between ENU and NED (the turn is its own inverse).

    Parameters
    ----------
    vectors : ndarray, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3)
    """
    return vectors[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def enu_to_ned_covariance(covariance: np.ndarray) -> np.ndarray:
    """Covariances of world vectors between ENU and NED (the turn is its own inverse).

    Parameters
    ----------
    covariance : ndarray, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    flat = covariance.reshape(*covariance.shape[:-2], 9)
    out = np.empty(flat.shape)
    for k, (place, sign) in enumerate(_WORLD):
        np.multiply(flat[..., place], sign, out=out[..., k])
    out += 0.0  # which leaves no negative zero
    return out.reshape(covariance.shape)


_Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _parts(q: np.ndarray) -> _Parts:
    return q[..., 0], q[..., 1], q[..., 2], q[..., 3]


def _swap_world(parts: _Parts) -> _Parts:
    """Left product with the half turn about (1, 1, 0)/sqrt(2) that relates ENU and NED."""
    w, x, y, z = (_SQRT_HALF * part for part in parts)
    return -x - y, w + z, w - z, y - x


def _swap_body(parts: _Parts) -> _Parts:
    """Right product with the half turn about x that relates FLU and FRD."""
    w, x, y, z = parts
    return -x, w, z, -y


def q_nb_from_log(q_wxyz: np.ndarray, axes: str) -> np.ndarray:
    """Orientation of a log's Imu message as q_nb.

    Parameters
    ----------
    q_wxyz : ndarray, shape (..., 4)
        Scalar first: FLU in ENU for ``flu``, FRD in NED for ``frd``.
    axes : {'flu', 'frd'}

    Returns
    -------
    ndarray, shape (..., 4)
    """
    if axes != "flu":
        return q_wxyz
    return np.stack(_swap_world(_swap_body(_parts(q_wxyz))), axis=-1)


def q_for_log(q_nb: np.ndarray, axes: str, world: str) -> np.ndarray:
    """Orientation to write: of the log's body axes in the chosen world.

    Parameters
    ----------
    q_nb : ndarray, shape (..., 4)
    axes : {'flu', 'frd'}
    world : {'enu', 'ned'}

    Returns
    -------
    ndarray, shape (..., 4)
        Scalar first, scalar part not negative.
    """
    parts = _parts(np.asarray(q_nb))
    if axes == "flu":
        parts = _swap_body(parts)
    if world == "enu":
        parts = _swap_world(parts)
    sign = np.where(parts[0] < 0, -1.0, 1.0)
    q = np.empty(np.shape(q_nb))
    for k in range(4):
        np.multiply(parts[k], sign, out=q[..., k])
    return q
