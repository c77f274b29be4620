"""Diagnosis of a bad filter run: the likely cause, by name.

A filter with a wrong setting does not say so. Each wrong setting leaves a trace of its own:

==================  ==============================================================================
kind                trace
==================  ==============================================================================
axes                another assignment of the gyro axes fits velocity changes far better
initial-attitude    velocity changes of the first two minutes give another attitude than the start:
                    tilt (gravity where it cannot be: mount, body axes), or heading
latency             fixes run ahead of the IMU's motion, or behind
velocity-lag        positions and velocities of the receiver are not of one instant
lever-arm           fixes move with the vehicle's turns
gnss-noise          innovations of a channel are larger or smaller than their sigma, and white
imu-noise           they are larger, and follow one another
divergence          fixes are gated, the filter begins anew; named even where no cause shows
==================  ==============================================================================

Causes are judged in this order, as one wrong thing disturbs what comes after it: with wrong axes
or a wrong start nothing else is looked at.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, sections 14.3 and 17.3.
.. [2] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
   Navigation", 2001, section 5.4: consistency of filters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.chi_square import MEDIAN_SQUARE
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import from_dcm, log, multiply, normalise, rotate, to_dcm
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.fix_velocity import velocity_lag
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets
from sinstool.methods.ins_gnss.results import GnssDiagnostics, UpdateColumns
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.methods.strapdown.followed_rates import followed_rates

# Columns of an innovation by channel
CHANNELS = {
    "horizontal position": (0, 1),
    "height": (2,),
    "horizontal velocity": (3, 4),
    "vertical velocity": (5,),
}

_FIRST_S = 120.0  # of velocity changes that must fit the start
_SETTLED_S = 30.0
_LEAST = 20  # epochs
_TOO_LARGE, _TOO_SMALL = 4.0, 0.25  # of innovations squared over their variance
_FOLLOWING = 0.4  # correlation of successive innovations
_LAG_S = 0.03
_SIGMAS = 5.0
_TURNED = float(np.deg2rad(5.0))
_AXES_FIT = 0.2  # of the squares that the log's own axes leave
_GATED = 0.2


def diagnose(
    start: Start,
    updates: UpdateColumns,
    gnss: GnssDiagnostics,
    fixes: GnssEpochs,
    settings: Settings,
    restarts: int = 0,
    offsets: ReceiverOffsets | None = None,
) -> tuple[Finding, ...]:
    """Look for what is wrong with a run.

    Parameters
    ----------
    updates : UpdateColumns
        Of the filter, from the start on; a whole run, or enough minutes of one.
    fixes : GnssEpochs
        All that the filter took, or those of these minutes.
    restarts : int, optional
    offsets : ReceiverOffsets, optional
        Latency and lever arm as the fixes show them.

    Returns
    -------
    tuple of Finding
        The most fundamental one first; none where all is well.
    """
    if len(updates) < 10 or len(gnss) < _LEAST:
        return ()
    first = _first_minute(start, updates, fixes, settings)
    if first and offsets is not None:
        # Velocities at wrong times, or of an antenna elsewhere, fit no attitude
        shown = settings
        if offsets.latency_contradicts(settings.gnss_latency):
            shown = replace(shown, gnss_latency=offsets.latency_s)
        if offsets.arm_contradicts:
            x, y, z = offsets.arm_b.tolist()
            shown = replace(shown, lever_arm_b=(x, y, z))
        if shown is not settings:
            first = _first_minute(start, updates, fixes, shown)
    if first:
        return tuple(first)
    findings = _lag(fixes) if offsets is None else _time_and_arm(offsets, settings) + _lag(fixes)
    if not findings:
        findings += _noise(gnss)
    return (*findings, *_divergence(gnss, restarts, not findings))


# --- the first minute: axes and attitude --------------------------------------------------


def _first_minute(
    start: Start, updates: UpdateColumns, fixes: GnssEpochs, settings: Settings
) -> list[Finding]:
    """Does the start's attitude, carried on by the gyros, turn forces into velocity changes?"""
    began = _begin(updates)
    end = began + round(_FIRST_S * 1e9)
    valid = fixes.time_ns - round(settings.gnss_latency * 1e9)
    rows = (valid >= began) & (valid <= min(end, int(updates.time_ns[-1])))
    rows &= np.isfinite(fixes.velocity_n).all(axis=1)
    if np.count_nonzero(rows) < 10:
        return []
    valid, velocity = valid[rows], fixes.velocity_n[rows]
    part = updates.time_ns <= end
    interval = intervals_of(updates)[part]
    theta = updates.omega_ib_b[part] * interval[:, None]
    dv = updates.specific_force_b[part] * interval[:, None]
    ends: FloatArray = (updates.time_ns[part] - began).astype(np.float64) * 1e-9
    at: FloatArray = (valid - began).astype(np.float64) * 1e-9
    # Five fixes at a time: noise of single ones counts less
    many = max(1, round(2.0 / float(np.median(np.diff(at)))))
    rates = followed_rates(updates.time_ns[part], interval, theta)
    arm = np.asarray(settings.lever_arm_b)
    wahba = _Wahba(ends, interval, theta, dv, rates, arm, at, velocity, start, many)
    fit = wahba.solve(np.eye(3))
    best, axes = fit.mean_square, np.eye(3)
    if fit.mean_square > wahba.noise(settings):
        tried = [(wahba.solve(c).mean_square, c) for c in _signed_permutations()]
        best = min(squares for squares, _ in tried)
        # Of those that fit alike, the one with the fewest signs turned and axes moved
        alike = [c for squares, c in tried if squares <= 1.5 * best]
        axes = min(alike, key=lambda c: (np.sum(c < 0.0), -np.abs(np.diag(c)).sum()))
    if best < _AXES_FIT * fit.mean_square and not np.array_equal(axes, np.eye(3)):
        ratio = float(np.sqrt(fit.mean_square / max(best, 1e-9)))
        return [
            Finding(
                "axes",
                "gyro and accelerometer axes do not belong together: velocity changes fit"
                f" {ratio:.0f} times better with the gyro's x, y, z taken as {_axes_text(axes)}: do"
                " not trust the solution",
                Severity.LOST,
                answer="check the body axes and the driver's signs",
                numbers={"residual_ratio": ratio},
            )
        ]
    # At rest a fit turns noise and drift into a heading: what GNSS sees change must be plain
    lively = wahba.lively(settings)
    seen = fit if lively is None else wahba.solve(np.eye(3), lively)
    return _attitude_findings(seen, start, many, lively is not None)


@dataclass(frozen=True)
class _Fit:
    """A solution of Wahba's problem.

    Attributes
    ----------
    mean_square : float
        Of the velocity changes that is left, (m/s)^2.
    dcm : ndarray, shape (3, 3)
        C_nb of the start.
    alpha : ndarray, shape (n, 3)
        Velocity changes by the accelerometers, body axes of the start.
    """

    mean_square: float
    dcm: FloatArray
    alpha: FloatArray


@dataclass(frozen=True)
class _Wahba:
    """Wahba's problem with the velocity changes between fixes, `many` of them at a time.

    Forces are integrated in the body axes of the start, with what the antenna gains as the body
    turns, and velocity changes less gravity in NED; over a minute the Earth's turn of NED, 0.25
    deg, is far below what is looked for.
    """

    ends: FloatArray
    interval: FloatArray
    theta: FloatArray
    dv: FloatArray
    rates: FloatArray
    arm: FloatArray
    at: FloatArray
    velocity: FloatArray
    start: Start
    many: int

    def _windows(self, values: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
        return np.asarray(total[self.many :] - total[: -self.many])

    def _changes(self) -> FloatArray:
        """Of velocity by GNSS, less gravity."""
        gravity = earth.gravity_n(self.start.nav[0], self.start.nav[2])
        return self._windows(np.diff(self.velocity, axis=0) - gravity * np.diff(self.at)[:, None])

    def lively(self, settings: Settings) -> BoolArray | None:
        """Windows whose change of horizontal velocity is no noise; None where they are few."""
        lively = np.sum(self._changes()[:, :2] ** 2, axis=1) > self.noise(settings)
        return lively if np.count_nonzero(lively) >= _LEAST else None

    def solve(self, axes: FloatArray, rows: BoolArray | slice = slice(None)) -> _Fit:
        """The attitude that fits best with the gyro's axes taken as `axes`, shape (3, 3)."""
        turn = self.theta @ axes.T
        q = AttitudePropagator(np.array([1.0, 0.0, 0.0, 0.0])).push(turn, self.interval)
        before = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], q[:-1]])
        moved = np.cumsum(rotate(normalise(before + q), self.dv), axis=0)
        # A vehicle that turns on the spot moves its antenna only, and the other way than its IMU
        moved += rotate(q, np.cross(self.rates @ axes.T, self.arm))
        u = np.column_stack([np.interp(self.at, self.ends, moved[:, i]) for i in range(3)])
        alpha, beta = self._windows(np.diff(u, axis=0))[rows], self._changes()[rows]
        left, _, right = np.linalg.svd(beta.T @ alpha)
        middle = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
        dcm = left @ middle @ right
        return _Fit(float(np.mean((beta - alpha @ dcm.T) ** 2)), dcm, alpha)

    def noise(self, settings: Settings) -> float:
        """Mean square that noise explains, generously."""
        white = np.max(settings.gnss.velocity_white) + np.max(settings.gnss.velocity_markov)
        span = self.many * float(np.median(np.diff(self.at)))
        return float(9.0 * (2.0 * white**2 + (settings.imu.accel_bias * span) ** 2) + 0.01)


def _attitude_findings(fit: _Fit, start: Start, many: int, moving: bool) -> list[Finding]:
    """The attitude that fits velocity changes beside that of the start: at rest its tilt alone."""
    q_fit, q_start = from_dcm(fit.dcm), start.nav[6:10]
    off = log(multiply(q_fit, q_start * np.array([1.0, -1.0, -1.0, -1.0])))
    # Sigma of the solution: each window counts, though neighbours share all but one fix
    n_beta = fit.alpha @ fit.dcm.T
    information = np.einsum("ni,ni->n", n_beta, n_beta)[:, None, None] * np.eye(3)
    information = (information - n_beta[:, :, None] * n_beta[:, None, :]).sum(axis=0)
    own = max(fit.mean_square, 1e-4) * many * np.linalg.pinv(information)
    sigma = np.sqrt(np.diag(own + start.covariance_attitude_n))
    heading = float(abs(off[2]))
    # A large turn mixes its components; the angle of "up" between the two does not
    up = to_dcm(q_fit).T[:, 2] @ to_dcm(q_start).T[:, 2]
    tilt = float(np.arccos(np.clip(up, -1.0, 1.0)))
    if tilt > _TURNED + _SIGMAS * float(max(sigma[:2])):
        return [
            Finding(
                "initial-attitude",
                f"gravity is {np.rad2deg(tilt):.0f} deg from where the initial attitude has it: do"
                " not trust the solution",
                Severity.LOST,
                answer="the body axes, the mount or the initial attitude are wrong",
                numbers={"tilt_deg": float(np.rad2deg(tilt))},
            )
        ]
    if moving and heading > _TURNED + _SIGMAS * float(sigma[2]):
        return [
            Finding(
                "initial-heading",
                "velocity changes of the first two minutes say that the initial heading is"
                f" {np.rad2deg(heading):.0f} deg off, sigma"
                f" {np.rad2deg(np.sqrt(start.covariance_attitude_n[2, 2])):.1f} deg: do not trust"
                " the attitude",
                Severity.LOST,
                answer="leave --align out, so that heading is estimated in motion",
                numbers={"heading_deg": float(np.rad2deg(heading))},
            )
        ]
    return []


def _signed_permutations() -> list[FloatArray]:
    """All 48 ways to take three axes for others."""
    eye = np.eye(3)
    return [
        np.diag(signs) @ eye[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


def _axes_text(axes: FloatArray) -> str:
    names = []
    for row in axes:
        column = int(np.argmax(np.abs(row)))
        names.append(("-" if row[column] < 0.0 else "") + "xyz"[column])
    return ", ".join(names)


def _begin(updates: UpdateColumns) -> int:
    return int(updates.time_ns[0]) - int(updates.time_ns[1] - updates.time_ns[0])


def intervals_of(updates: UpdateColumns) -> FloatArray:
    """Duration of each update, s; of one behind a gap a few usual ones."""
    step = np.diff(updates.time_ns, prepend=_begin(updates)).astype(np.float64) * 1e-9
    return np.minimum(step, 5.0 * float(np.median(step)))


# --- time ---------------------------------------------------------------------------------


def _time_and_arm(offsets: ReceiverOffsets, settings: Settings) -> list[Finding]:
    findings = []
    if offsets.latency_contradicts(settings.gnss_latency):
        text = (
            f"the latency of GNSS is {1e3 * offsets.latency_s:.0f} ms"
            f" (+- {1e3 * offsets.sigma_s:.0f}), not {1e3 * settings.gnss_latency:.0f} ms, by the"
            " IMU's motion; the sigmas of the solution include the difference"
        )
        answer = f"leave --gnss-latency out, or give --gnss-latency {offsets.latency_s:.3f}"
        numbers = {"latency_s": offsets.latency_s, "sigma_s": offsets.sigma_s}
        findings.append(Finding("latency", text, answer=answer, numbers=numbers))
    if offsets.arm_contradicts:
        x, right, down = (float(v) for v in offsets.arm_off_b)
        sigmas = ", ".join(f"{sigma:.2f}" for sigma in offsets.arm_off_sigma_b)
        text = (
            "fixes move with the vehicle's turns as if the antenna were"
            f" {x:.1f} m forward, {right:.1f} m right and {down:.1f} m down (+- {sigmas}) of the"
            " lever arm in use; the sigmas of the solution include the difference"
        )
        arm = ",".join(f"{float(v):.2f}" for v in offsets.arm_b)
        answer = f"add --lever-arm {arm} if that is plausible on your vehicle"
        numbers = {"forward_m": x, "right_m": right, "down_m": down}
        findings.append(Finding("lever-arm", text, answer=answer, numbers=numbers))
    return findings


def _lag(fixes: GnssEpochs) -> list[Finding]:
    lag = velocity_lag(fixes)
    if not lag.differs_from(0.0, _LAG_S, _SIGMAS):
        return []
    when = "later" if lag.latency_s > 0.0 else "earlier"
    return [
        Finding(
            "velocity-lag",
            f"the receiver's velocities are stamped {1e3 * abs(lag.latency_s):.0f} ms {when} than"
            " its positions",
            answer=f"give --gnss-velocity-lag {lag.latency_s:.2f}",
            numbers={"velocity_lag_s": lag.latency_s},
        )
    ]


# --- innovations --------------------------------------------------------------------------


def _rows(gnss: GnssDiagnostics) -> np.ndarray:
    """Epochs that were compared, the filter having settled."""
    return np.asarray(
        (gnss.time_ns >= gnss.time_ns[0] + round(_SETTLED_S * 1e9))
        & ~gnss.withheld
        & ~gnss.restarted
        & (gnss.rows > 0)
    )


def _noise(gnss: GnssDiagnostics) -> list[Finding]:
    rows = _rows(gnss)
    # Against the noise of the settings, whatever the gate or an adapted filter made of it
    own = gnss.measurement_sigma[rows] ** 2
    assumed = gnss.innovation_sigma[rows] ** 2 - own * (1.0 - 1.0 / gnss.noise_ratio[rows])
    ratio = gnss.innovation[rows] / np.sqrt(assumed)
    findings = []
    for name, columns in CHANNELS.items():
        values = ratio[:, columns]
        values = values[np.isfinite(values).all(axis=1)]
        if len(values) < _LEAST:
            continue
        level = float(np.median(values**2)) / MEDIAN_SQUARE
        if _TOO_SMALL < level < _TOO_LARGE:
            continue
        follow = float(np.sum(values[1:] * values[:-1]) / np.sum(values * values))
        times = float(np.sqrt(level))
        kind = "gnss-noise"
        if level >= _TOO_LARGE and follow > _FOLLOWING:
            kind = "imu-noise"
            text = f"{times:.1f} times their sigma and follow one another"
            answer = "the IMU is worse than its assumed noise (grade)"
        elif level >= _TOO_LARGE:
            text = f"{times:.1f} times their sigma"
            answer = "the noise of GNSS is set too small"
        else:
            text = f"{times:.2f} of their sigma"
            answer = "the noise of GNSS is set too large"
        findings.append(
            Finding(
                kind,
                f"innovations of {name} are {text}",
                answer=answer,
                topic=name,
                numbers={"sigma_ratio": times},
            )
        )
    return findings


def _divergence(gnss: GnssDiagnostics, restarts: int, alone: bool) -> list[Finding]:
    compared = ~gnss.withheld & (gnss.rows > 0)
    share = float(np.mean(gnss.gated[compared])) if np.any(compared) else 0.0
    if share < _GATED and restarts == 0:
        return []
    why = "no cause shows: noise, a bad receiver or sensor" if alone else ""
    return [
        Finding(
            "divergence",
            f"filter and fixes do not agree: {share:.0%} of the fixes were too far off to be used,"
            f" {restarts} restarts",
            answer=why,
            numbers={"rejected_share": share, "restarts": float(restarts)},
        )
    ]
