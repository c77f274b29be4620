"""Attitude found in flight from inertial increments and GNSS velocity.

What callers use::

    imu = ImuIncrements(time_ns, delta_theta, delta_velocity)
    gnss = GnssFixes(time_ns, latitude, longitude, height, velocity_n, sigma_v=None)
    answer = align_in_flight(imu, gnss, AlignmentSettings(...))
    answer.status, answer.q_nb, answer.t_ns, answer.cov, answer.warnings
    answer.series.q_nb, answer.series.sigma_worst       # one row per fix used
    answer.attitude_at(time_ns)                          # any times of the segment

References
----------
.. [1] Qu, Li, Zhu, Wang, "In-flight alignment of a strapdown inertial navigation system by
   singular value decomposition", China Academy of Engineering Physics.
.. [2] M. Wu, Y. Wu, X. Hu, D. Hu, "Optimization-based alignment for inertial navigation
   systems: Theory and algorithm", Aerospace Science and Technology 15(1), 2011.
"""

from __future__ import annotations

from dataclasses import dataclass

from sinstool.alignment.inflight_types import (
    AlignmentSeries,
    AlignmentSettings,
    FloatArray,
    GateLimits,
    GnssFixes,
    ImuIncrements,
    RefinedErrors,
    SensorGrade,
    Status,
    TimeArray,
)

__all__ = [
    "AlignmentSeries",
    "AlignmentSettings",
    "GateLimits",
    "GnssFixes",
    "ImuIncrements",
    "InFlightAlignment",
    "RefinedErrors",
    "SensorGrade",
    "align_in_flight",
]


@dataclass(frozen=True)
class InFlightAlignment:
    """The answer.

    Attributes
    ----------
    status : {'ok', 'degraded', 'level-only', 'unobservable', 'failed'}
        ``ok`` up to 1 deg about the worst axis, ``degraded`` up to 5 deg, ``level-only``
        where only roll and pitch are known; the latter's `q_nb` holds an arbitrary heading.
    method, vectors : str
        As used.
    t_ns, t_q_ns, t_stop_ns : int
        When the attitude holds; start and end of the segment used.
    q_nb : ndarray, shape (4,)
        With ``w >= 0``; NaN where the status is ``unobservable`` or ``failed``.
    cov : ndarray, shape (3, 3)
        Of psi in NED, rad^2: the attitude found is ``(I + [psi x]) C_nb``.
    sigma_rad : ndarray, shape (3,)
        About north, east, down.
    sigma_worst : float
        About the worst axis, before an unknown heading is declared so, rad.
    rho : float
        Geometry of the vectors, 0 to 1.
    singular_values : ndarray, shape (3,)
        Of the attitude profile matrix, the last one with its sign.
    n_pairs, n_rejected : int
        Pairs with weight; fixes that the screen rejected.
    residual_rms : float
        Of the pairs, in the units of their vectors.
    chi2 : float
        Mean squared residual by what GNSS noise alone explains: about 1.
    time_to_align_s : float or None
        From the start to the first fix after which the worst-axis sigma stays below 1 deg.
    errors : RefinedErrors or None
    warnings : tuple of str
    series : AlignmentSeries or None
    """

    status: Status
    method: str
    vectors: str
    t_ns: int
    t_q_ns: int
    t_stop_ns: int
    q_nb: FloatArray
    cov: FloatArray
    sigma_rad: FloatArray
    sigma_worst: float
    rho: float
    singular_values: FloatArray
    n_pairs: int
    n_rejected: int
    residual_rms: float
    chi2: float
    time_to_align_s: float | None
    errors: RefinedErrors | None
    warnings: tuple[str, ...]
    series: AlignmentSeries | None

    def attitude_at(self, time_ns: TimeArray) -> FloatArray:
        """Attitude at any times of the segment, shape (n, 4)."""
        raise NotImplementedError


def align_in_flight(
    imu: ImuIncrements, gnss: GnssFixes, settings: AlignmentSettings | None = None
) -> InFlightAlignment:
    """Align in flight.

    Parameters
    ----------
    imu : ImuIncrements
    gnss : GnssFixes
    settings : AlignmentSettings, optional

    Returns
    -------
    InFlightAlignment

    Raises
    ------
    AlignmentError
        If the log cannot be aligned at all: no GNSS velocity, no common time.
    """
    raise NotImplementedError
