"""The door: vectors and quaternions between a log's axes and sinstool's.

A log's body axes are FLU (REP-103) or FRD; its world is ENU for FLU logs and NED for FRD logs,
as each convention has it. Inside, body is FRD and the navigation frame NED.
"""

from __future__ import annotations

import numpy as np

# Half turn about x: takes FLU to FRD and back.
_FLIP = np.array([1.0, -1.0, -1.0])
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


def _swap_world(q: np.ndarray) -> np.ndarray:
    """Left product with the half turn about (1, 1, 0)/sqrt(2) that relates ENU and NED."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return _SQRT_HALF * np.stack((-x - y, w + z, w - z, y - x), axis=-1)


def _swap_body(q: np.ndarray) -> np.ndarray:
    """Right product with the half turn about x that relates FLU and FRD."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack((-x, w, z, -y), axis=-1)


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
    return _swap_world(_swap_body(q_wxyz)) if axes == "flu" else q_wxyz


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
    q = _swap_body(q_nb) if axes == "flu" else q_nb
    q = _swap_world(q) if world == "enu" else q
    return np.where(q[..., :1] < 0, -q, q)
