"""The model of heading-sensitive error: to all orders, and in the linear form of the paper.

What the calibration gets wrong is one matrix in ``b``,

    X = C~_s^b K~_g K_g^-1 C_b^s - I,

tildes marking what the user believes. Averaged over whole turns at a constant rate only three
numbers of it are left, ``a = (X11 + X22)/2``, ``c = X33`` and ``d = (X21 - X12)/2``:

    mean(Rz X Rz^T) = [[a, -d, 0], [d, a, 0], [0, 0, c]],

and this is exact. Alone ``c`` meets the rate Omega of the table, and ``lambda2 = -3 c``.

Signs. With eqs. (1), (5), (6) of [1]_ an error is ``estimate - truth``, so that (12) reads
``dpsi = -dw_E / (w_ie cos L)``: the printed plus is that of the opposite difference. Defined by
``K = d psi_hat / d Omega`` and eq. (16), lambda2 is minus the sum of the calibration's errors
eps1 + eps2 + eps3, and (14) and (16) hold as printed without anybody having to know those.

References
----------
.. [1] H. Yu et al., "On-line calibration and compensation of heading-sensitive error for triad
   constant-rate biased RLG system", J. NUDT 35(4), 2013, 161-165.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.core.earth import EARTH_RATE, earth_rate_n

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RotationMean:
    """What whole turns leave of a calibration error.

    Attributes
    ----------
    a : float
        Scale of the rates across the axis.
    c : float
        Scale along the axis, X33.
    d : float
        Turn about the axis, rad; a constant offset ``-d`` of heading, to first order.
    """

    a: float
    c: float
    d: float

    @property
    def lambda2(self) -> float:
        """Heading-sensitive error coefficient, rad."""
        return -3.0 * self.c

    def rate_error(self, rate: float, u_b0: ArrayLike) -> FloatArray:
        """Mean error of the rate in ``b0``, rad/s.

        Parameters
        ----------
        rate : float
            Omega of the table, rad/s.
        u_b0 : array_like, shape (3,)
            Earth rate in ``b0``, rad/s.
        """
        u = np.asarray(u_b0, dtype=np.float64)
        return np.array(
            [
                self.a * u[0] - self.d * u[1],
                self.d * u[0] + self.a * u[1],
                self.c * (rate + u[2]),
            ]
        )


def error_matrix(
    C_s_to_b_believed: ArrayLike, K_g_believed: ArrayLike, K_g: ArrayLike, C_s_to_b: ArrayLike
) -> FloatArray:
    """X, the relative error of rates in ``b``; shape (3, 3).

    Parameters
    ----------
    C_s_to_b_believed, K_g_believed : array_like, shape (3, 3)
        Of the calibration in use; eqs. (1) and (2) of [1]_ of the module.
    K_g, C_s_to_b : array_like, shape (3, 3)
        The true ones.
    """
    believed = np.asarray(C_s_to_b_believed, dtype=np.float64) @ np.asarray(K_g_believed)
    true = np.asarray(C_s_to_b, dtype=np.float64) @ np.asarray(K_g)
    return np.asarray(believed @ np.linalg.inv(true) - np.eye(3))


def rotation_mean(X: ArrayLike) -> RotationMean:
    """Mean of ``Rz X Rz^T`` over whole turns.

    Parameters
    ----------
    X : array_like, shape (3, 3)
        From :func:`error_matrix`.
    """
    x = np.asarray(X, dtype=np.float64)
    return RotationMean(
        a=float(x[0, 0] + x[1, 1]) / 2.0, c=float(x[2, 2]), d=float(x[1, 0] - x[0, 1]) / 2.0
    )


def east_rate_error(mean: RotationMean, rate: float, C_nb0: ArrayLike, latitude: float) -> float:
    """East component of the mean rate error, rad/s: (13) of [1]_ of the module to all orders.

    Parameters
    ----------
    rate : float
        Omega, rad/s.
    C_nb0 : array_like, shape (3, 3)
        True attitude of the base.
    latitude : float
        rad.

    Notes
    -----
    ``C23 [c Omega + (c - a) u_z] + d w_ie (C33 cos L + C13 sin L)`` with
    ``u_z = w_ie (C13 cos L - C33 sin L)``.
    """
    C = np.asarray(C_nb0, dtype=np.float64)
    cos, sin = np.cos(latitude), np.sin(latitude)
    u_z = EARTH_RATE * (C[0, 2] * cos - C[2, 2] * sin)
    leaning = C[1, 2] * (mean.c * rate + (mean.c - mean.a) * u_z)
    turned = mean.d * EARTH_RATE * (C[2, 2] * cos + C[0, 2] * sin)
    return float(leaning + turned)


def heading_error(mean: RotationMean, rate: float, C_nb0: ArrayLike, latitude: float) -> float:
    """Error of heading, estimate minus truth, rad, to all orders.

    It is that of a heading from the mean rate and a vertical that is known exactly: north is
    where the horizontal part of the rate points.

    Parameters
    ----------
    rate : float
        Omega, rad/s.
    C_nb0 : array_like, shape (3, 3)
        True attitude of the base.
    latitude : float
        rad.
    """
    C = np.asarray(C_nb0, dtype=np.float64)
    earth = earth_rate_n(latitude)
    w = earth + C @ mean.rate_error(rate, C.T @ earth)
    return float(-np.arctan2(w[1], w[0]))


def lambda1(rate: ArrayLike, latitude: float) -> FloatArray:
    """``Omega - w_ie sin L``, rad/s, of (13) in [1]_ of the module.

    Parameters
    ----------
    rate : array_like
        Omega, rad/s.
    latitude : float
        rad.

    Notes
    -----
    Errors of orthogonality alone give ``Omega - 1.5 w_ie sin L`` and errors of scale alone
    ``Omega``; the printed factor is kept as the difference is below 0.001 arcsec.
    """
    return np.asarray(rate, dtype=np.float64) - EARTH_RATE * np.sin(latitude)


def sensitivity(rate: ArrayLike, C23: ArrayLike, latitude: float) -> FloatArray:
    """Derivative of heading by lambda2: ``lambda1 C23 / (3 w_ie cos L)``.

    Parameters
    ----------
    rate : array_like
        Omega, rad/s.
    C23 : array_like
        East component of the axis of rotation.
    latitude : float
        rad.
    """
    leaning = np.asarray(C23, dtype=np.float64)
    return lambda1(rate, latitude) * leaning / (3.0 * EARTH_RATE * np.cos(latitude))


def linear_heading_error(
    lambda2: ArrayLike, rate: ArrayLike, C23: ArrayLike, latitude: float
) -> FloatArray:
    """Heading-sensitive error, rad, by (14) of [1]_ of the module.

    To be subtracted from the heading. Arguments as those of :func:`sensitivity`, and
    ``lambda2`` in rad.
    """
    return np.asarray(lambda2, dtype=np.float64) * sensitivity(rate, C23, latitude)


def slope(lambda2: float, C23: float, latitude: float) -> float:
    """K_HSE, derivative of heading by Omega in s, of a coefficient; (16) solved for it."""
    return lambda2 * C23 / (3.0 * EARTH_RATE * float(np.cos(latitude)))


def lambda2_from_slope(K: float, C23: float, latitude: float) -> float:
    """Coefficient in rad from K_HSE in s; (16) of [1]_ of the module."""
    return 3.0 * EARTH_RATE * float(np.cos(latitude)) * K / C23


def nonlinearity(lambda2: float, rate: float, tilt: float, latitude: float) -> float:
    """Relative error of the linear form, ``c Omega tilt / (2 w_ie cos L)``.

    Parameters
    ----------
    lambda2 : float
        rad.
    rate : float
        Omega, rad/s.
    tilt : float
        Angle of the axis of rotation against the vertical, rad.
    latitude : float
        rad.

    Returns
    -------
    float
        The linear form should not be used above 0.01.
    """
    c = abs(lambda2) / 3.0
    return float(0.5 * c * abs(rate) * abs(tilt) / (EARTH_RATE * np.cos(latitude)))


def slope_gain(rates: ArrayLike) -> float:
    """Deviation of a slope against rate over that of one run, 1/(rad/s).

    Parameters
    ----------
    rates : array_like, shape (n,)
        One for each run, rad/s.
    """
    x = np.asarray(rates, dtype=np.float64)
    return float(1.0 / np.sqrt(np.sum((x - x.mean()) ** 2)))
