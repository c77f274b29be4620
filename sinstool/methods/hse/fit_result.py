"""Options and results of the calibration of heading-sensitive error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.axial import AxialFit
from sinstool.methods.hse.run import HseRun

METHODS = ("joint", "heading", "axial")
FORMS = ("regressor", "paper")
WEIGHTS = ("turns", "equal")


@dataclass(frozen=True)
class FitOptions:
    """How the calibration is made.

    Attributes
    ----------
    method : {"joint", "heading", "axial"}
        Which estimate of lambda2 counts.
    form : {"regressor", "paper"}
        Of the method ``heading``.
    weights : {"turns", "equal"}
        By the scatter of each run's turns, or all the same.
    drift : bool
        Estimate a drift of heading with time too.
    skip_warmup_s : float
        Leave out runs that start earlier than this, s: after the start of the first log where
        the logs' starts are known, else after that of their own log.
    exclude : tuple of str
        Identifiers of runs to leave out.
    reject_outliers : bool
        Leave out repeats that do not belong, at least two at each rate and position remaining.
    outlier_alpha : float
        Probability that any repeat is left out where all are sound.
    """

    method: str = "joint"
    form: str = "regressor"
    weights: str = "turns"
    drift: bool = False
    skip_warmup_s: float = 0.0
    exclude: tuple[str, ...] = ()
    reject_outliers: bool = True
    outlier_alpha: float = 0.01

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("method", self.method, METHODS),
            ("form", self.form, FORMS),
            ("weights", self.weights, WEIGHTS),
        ):
            if value not in choices:
                raise ConfigurationError(
                    f"{name} {value!r} is unknown", f"give one of {', '.join(choices)}"
                )
        if not 0.0 < self.outlier_alpha < 1.0:
            raise ConfigurationError(
                f"outlier_alpha is {self.outlier_alpha}", "give a probability between 0 and 1"
            )


@dataclass(frozen=True)
class RunFit:
    """Residual, leverage and use of one run in the fit.

    Attributes
    ----------
    reason : str
        Why it was not used; empty if it was.
    position : int
        Number of its position, from 0.
    residual : float or None
        Of its heading, rad; also for runs left out, where their position was fitted.
    leverage, studentised : float or None
        See :class:`sinstool.methods.hse.least_squares.LeastSquares`.
    """

    used: bool
    reason: str = ""
    position: int = 0
    residual: float | None = None
    leverage: float | None = None
    studentised: float | None = None


@dataclass(frozen=True)
class HseFit:
    """Result of a calibration; values that the runs do not determine are None.

    Attributes
    ----------
    method, form : str
        Those used, which may differ from the options; ``warnings`` then says why.
    observable : bool
        The lean of the axis allows lambda2 to be had from headings.
    lambda2, sigma_lambda2 : float or None
        Coefficient and standard deviation by ``method``, rad.
    ci95_lambda2 : tuple of two float, or None
    lambda2_heading, sigma_lambda2_heading : float or None
        From headings, whatever the method, rad.
    K, sigma_K : float or None
        Slope of heading against rate by heading-sensitive error alone where the lean is
        ``C23``, s.
    ci95_K : tuple of two float, or None
    delay, sigma_delay : float or None
        Age of the encoder's readings at their stamps (method joint), s.
    psi0 : tuple of float
        Heading of each position free of heading-sensitive error, rad.
    parameters : tuple of str
        Names of the rows of ``covariance``.
    covariance : ndarray, shape (p, p)
    C23, sigma_C23 : float
        Of the position that leans most.
    C23_spread : float
        Widest range within a position over the largest lean.
    latitude : float
        Mean, rad.
    chi2 : float or None
        By the scatter of turns; None with equal weights.
    s : float or None
        Scatter of the headings about the fit, rad, with ``dof``.
    r2, F_lof, p_lof, condition : float or None
        Share of scatter explained, test for lack of fit, condition number of the design.
    distribution : str
        Behind the intervals: ``t``, ``z``, or ``turns`` when nothing but the scatter of turns
        stands behind a fit without redundancy.
    rates : tuple of float
        Distinct mean rates in use, rad/s.
    rate_span : float
        Range of the rates in use, rad/s.
    tilt : float
        Largest tilt of a run in use, rad.
    max_rate : float
        Largest magnitude in use, rad/s.
    run_fits : tuple of RunFit
        In the order of ``runs``.
    """

    method: str
    form: str
    observable: bool
    axial: AxialFit
    latitude: float
    C23: float
    sigma_C23: float
    C23_spread: float
    rates: tuple[float, ...]
    rate_span: float
    max_rate: float
    tilt: float
    runs: tuple[HseRun, ...]
    run_fits: tuple[RunFit, ...]
    lambda2: float | None = None
    sigma_lambda2: float | None = None
    ci95_lambda2: tuple[float, float] | None = None
    lambda2_heading: float | None = None
    sigma_lambda2_heading: float | None = None
    K: float | None = None
    sigma_K: float | None = None
    ci95_K: tuple[float, float] | None = None
    delay: float | None = None
    sigma_delay: float | None = None
    psi0: tuple[float, ...] = ()
    parameters: tuple[str, ...] = ()
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    dof: int = 0
    chi2: float | None = None
    s: float | None = None
    r2: float | None = None
    F_lof: float | None = None
    p_lof: float | None = None
    condition: float | None = None
    distribution: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def n_used(self) -> int:
        """Number of runs in the fit."""
        return sum(one.used for one in self.run_fits)

    @property
    def z_consistency(self) -> float | None:
        """Headings' lambda2 less the axial one, in standard deviations."""
        if self.lambda2_heading is None or self.sigma_lambda2_heading is None:
            return None
        both = np.hypot(self.sigma_lambda2_heading, self.axial.sigma_lambda2)
        if not both > 0.0:
            return None
        return float((self.lambda2_heading - self.axial.lambda2) / both)
