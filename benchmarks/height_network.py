"""The height damping network: gains, roots, responses, sampling, gaps; ours beside published.

python benchmarks/height_network.py
python benchmarks/height_network.py --runs 300

Published numbers: table of gains by an independent computer algebra; gaps by an independent
simulation of the whole mechanisation (paper's barometer, 10 m over 500 s; accelerometer 50 ug
and 10 ug/sqrt(Hz)); a MEMS flight with 2 mg, 150 ug/sqrt(Hz) and 1 mg per 100 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from benchmarks.common import UG, numbers, parser, print_table
from sinstool.core.earth import normal_gravity
from sinstool.methods.height.layout import SHADOW_TAU
from sinstool.methods.height.network import gravity_gradient, paper, pole_matched_gains
from sinstool.methods.height.vertical import VerticalChannel
from tests.helpers.height_network import NetworkTheory

LATITUDE = np.radians(34.0 + 14.0 / 60.0 + 12.645 / 3600.0)
START = 388.0
W2 = gravity_gradient(LATITUDE, START)

GAINS = {
    (2.4, 0.0): ("1.25", "0.520836413", "0.072337963"),
    (2.4, 0.5): ("1.00766706", "0.48466588", "0.072337963"),
    (2.4, 0.8): ("0.8796289", "0.462963876", "0.072337963"),
    (10.0, 0.0): ("0.3", "0.03000308", "0.001"),
    (10.0, 0.5): ("0.28524868", "0.02950264", "0.001"),
    (30.0, 0.0): ("0.1", "0.00333641", "3.7037e-5"),
    (100.0, 0.0): ("0.03", "3.0308e-4", "1e-6"),
}
DEVIATIONS = {128.0: 0.0012, 50.0: 0.003, 10.0: 0.016, 1.0: 0.13}
# Height and velocity at the end of a gap, RMS, and peak of the velocity after it.
GAPS = {
    ("navigation", 2.4, 60.0, False): (97.0, 2.9, 30.7),
    ("navigation", 2.4, 60.0, True): (7.0, 0.09, 0.84),
    ("navigation", 30.0, 60.0, True): (7.9, 0.14, None),
    ("navigation", 100.0, 60.0, True): (None, None, None),
    ("mems", 2.4, 30.0, False): (9.9, 2.96, None),
    ("mems", 2.4, 30.0, True): (4.9, 0.47, None),
    ("mems", 10.0, 30.0, True): (5.5, 0.40, None),
    ("mems", 5.0, 30.0, True): (None, None, None),
    ("mems", 5.0, 60.0, True): (None, None, None),
}


@dataclass(frozen=True)
class Sensors:
    """White noises as power densities; wandering ones as Markov processes (sigma, time)."""

    baro: tuple[float, float]
    accel_white: float
    bias_walk: float
    baro_white: float = 0.0
    tilt: tuple[float, float] = (0.0, 1.0)

    def model(self, network: NetworkTheory | None) -> tuple[np.ndarray, np.ndarray]:
        """Rate matrix and noise of the errors of h, v, A, tilt, bias, baro; None: it coasts."""
        f, q = np.zeros((6, 6)), np.zeros((6, 6))
        f[0, 1], f[1, 0], f[1, 2] = 1.0, W2, -1.0
        if network is not None:
            f[:3, :3] = network.matrix
            f[:3, 5] = drive = network.input_vector("baro")
            q[:3, :3] = self.baro_white * np.outer(drive, drive)
        f[1, 3] = f[1, 4] = 1.0
        f[3, 3], f[4, 4], f[5, 5] = -1.0 / self.tilt[1], -1e-6, -1.0 / self.baro[1]
        q[1, 1] += self.accel_white
        q[3, 3] = 2.0 * self.tilt[0] ** 2 / self.tilt[1]
        q[4, 4], q[5, 5] = self.bias_walk, 2.0 * self.baro[0] ** 2 / self.baro[1]
        return f, q

    def stationary(self, network: NetworkTheory) -> np.ndarray:
        """Covariance of the settled network."""
        f, q = self.model(network)
        return np.asarray(solve_continuous_lyapunov(f, -q))

    def after_gap(self, tau: float, length: float) -> tuple[float, float]:
        """Sigma of the drift of h and of v after a coast from a settled network of tau."""
        p = self.stationary(NetworkTheory(tau, 0.0, W2))
        p[0, :] = p[:, 0] = 0.0
        f, q = self.model(None)
        step = 0.01
        phi = expm(f * step)
        for _ in range(round(length / step)):
            p = phi @ p @ phi.T + q * step
        return float(np.sqrt(p[0, 0])), float(np.sqrt(p[1, 1]))


GRADES = {
    "navigation": Sensors((10.0, 500.0), (10.0 * UG) ** 2, 0.0),
    "mems": Sensors(
        (3.0, 300.0),
        (150.0 * UG) ** 2,
        (1000.0 * UG) ** 2 / 100.0,
        baro_white=0.2**2 / 10.0,
        tilt=(0.02, 5.0),
    ),
}


def print_gains() -> None:
    """Gains, and the roots of the printed and of the corrected matrix."""
    rows = []
    for (tau, k4), known in GAINS.items():
        ours = NetworkTheory(tau, k4, 3.08e-6).gains
        rows.append((f"{tau:g}, {k4:g}", numbers(ours, ".9g"), " ".join(known)))
    print_table(("tau, K4", "ours", "published"), rows, "Gains K1, K2, K3 (w2 = 3.08e-6)")
    print()
    network = NetworkTheory(paper().tau, paper().k4, W2)
    for name, matrix in (("printed", network.printed_matrix), ("corrected", network.matrix)):
        print(f"eq. (2) as {name}: roots {np.round(np.linalg.eigvals(matrix), 4)}")
    print(f"(-1/tau = {-1 / network.tau:.4f}; published for the printed one: 0.009 +- 0.180j)\n")


def _free(interval: float, w2: float) -> np.ndarray:
    w = np.sqrt(w2)
    c, s = np.cosh(w * interval), np.sinh(w * interval) / w
    return np.array([[c, s, -(c - 1.0) / w2], [w2 * s, c, -s], [0.0, 0.0, 1.0]])


def print_poles() -> None:
    """Poles of the sampled network: without gravity, with it, and with intervals at random."""
    rows = []
    for tau, k4 in ((2.4, 0.0), (2.4, 0.5), (10.0, 0.0), (30.0, -1.0), (100.0, 0.0)):
        worst, spread = 0.0, 0.0
        for t in np.geomspace(0.005, 5.0, 40):
            l1, l2, l3 = pole_matched_gains(t, tau, k4, 0.0)
            step = np.eye(3) - np.outer([l1, l2, -l3], [1.0, k4, 0.0])
            phi = np.array([[1.0, t, -t * t / 2], [0.0, 1.0, -t], [0.0, 0.0, 1.0]])
            r = np.exp(-t / tau)
            scale = np.array([1.0, t, t * t])
            poly = np.poly(scale[:, None] * (step @ phi) / scale)
            worst = max(worst, np.abs(poly - [1.0, -3 * r, 3 * r * r, -(r**3)]).max())
            l1, l2, l3 = pole_matched_gains(t, tau, k4, W2)
            step = np.eye(3) - np.outer([l1, l2, -l3], [1.0, k4, 0.0])
            rates = -np.log(np.linalg.eigvals(step @ _free(t, W2)).astype(complex)) / t * tau
            spread = max(spread, np.abs(rates - 1.0).max())
        rng = np.random.default_rng(1)
        largest = 0.0
        scale = np.array([1.0, tau, tau * tau])
        for _ in range(40):
            product, passed = np.eye(3), 0.0
            while passed < 25 * tau:
                t = rng.uniform(0.02, 3.0)
                l1, l2, l3 = pole_matched_gains(t, tau, k4, W2)
                step = np.eye(3) - np.outer([l1, l2, -l3], [1.0, k4, 0.0])
                product = step @ _free(t, W2) @ product
                passed += t
            largest = max(largest, np.linalg.norm(scale[:, None] * product / scale, 2))
        rows.append((f"{tau:g}, {k4:g}", f"{worst:.1e}", f"{100 * spread:.1f} %", f"{largest:.1e}"))
    print_table(
        (
            "tau, K4",
            "polynomial - (z - r)^3",
            "roots off with gravity (3.3 %, 4.5 % at 2.4 s)",
            "norm after 25 tau of random T (4e-7)",
        ),
        rows,
        "Sampled network, T = 0.005 to 5 s",
    )
    print()


def print_responses() -> None:
    """Closed forms beside their published peaks, and the sampled step beside the continuous."""
    t = np.linspace(0.0, 60.0, 60001)
    rows = []
    for k4, over, settle, speed, rise in (
        (0.0, 20.6, 5.6, 0.333, 1.559),
        (0.5, 9.5, 3.0, 0.314, 0.774),
        (0.8, 4.6, 2.9, 0.302, 0.462),
    ):
        network = NetworkTheory(2.4, k4, W2)
        step = network.step_response("baro", t)
        last = np.flatnonzero(np.abs(step[:, 0] - 1.0) > 0.02)[-1]
        force = network.step_response("acceleration", t)[:, 0].max()
        ours = (100 * (step[:, 0].max() - 1), t[last] / 2.4, step[:, 1].max(), force)
        rows.append((f"{k4:g}", numbers(ours, ".4g"), numbers((over, settle, speed, rise))))
    print_table(
        ("K4", "closed form", "published"),
        rows,
        "tau = 2.4 s: overshoot %, 2 % settling / tau, peak v of 1 m; peak h of 1 m/s^2",
    )
    print()
    rows = []
    for rate, known in DEVIATIONS.items():
        cells = []
        for k4 in (0.0, 0.5):
            network = NetworkTheory(2.4, k4, W2)
            interval = 1.0 / rate
            gains = np.array(pole_matched_gains(interval, 2.4, k4, W2)) * [1.0, 1.0, -1.0]
            phi, x, after = _free(interval, W2), np.zeros(3), []
            for _ in range(int(40 * rate)):
                x = phi @ x
                x = x - gains * (x[0] + k4 * x[1] - 1.0)
                after.append(x[0])
            exact = network.step_response("baro", np.arange(1, len(after) + 1) * interval)
            cells.append(np.abs(np.array(after) - exact[:, 0]).max())
        rows.append((f"{rate:g}", f"{cells[0]:.4f}", f"{cells[1]:.4f}", known))
    print_table(
        ("baro Hz", "K4 = 0", "K4 = 0.5", "published"),
        rows,
        "Step of 1 m, sampled against continuous, tau = 2.4 s, m",
    )
    print()


def print_flight() -> None:
    """The standalone channel with perfect sensors: climb bias, run-away without a barometer."""
    t = np.arange(12001) / 100.0
    s = np.clip((t - 30.0) / 4.0, 0.0, 1.0)
    a = 5.0 / 4.0 * (1.0 - np.cos(2 * np.pi * s)) * ((s > 0) & (s < 1))
    h = START + 20.0 * (s * s / 2 + (np.cos(2 * np.pi * s) - 1) / (4 * np.pi**2))
    h += 5.0 * np.maximum(t - 34.0, 0.0)
    stamps = np.round(t * 1e9).astype(np.int64)
    force = a + normal_gravity(LATITUDE, h)
    slow = START + lfilter([0.5 / 100.5, 0.5 / 100.5], [1.0, -99.5 / 100.5], h - START)
    rows = []
    for k4, lag in ((0.0, 0.0), (0.5, 0.0), (0.8, 0.0), (0.0, 1.0), (-1.0, 1.0)):
        baro = slow if lag else h
        channel = VerticalChannel(
            NetworkTheory(2.4, k4, W2), LATITUDE, height=START, baro_lag=max(-k4, 0.0)
        )
        out = channel.push(stamps, force, stamps[::2], baro[::2])
        bias = np.mean((out.height - h)[-1000:])
        rows.append((f"{k4:g}, {lag:g}", f"{bias:.3f}", f"{-(k4 + lag) * 5.0:.3f}"))
    print_table(
        ("K4, baro lag s", "ours", "-(K4 + lag) V"), rows, "Height bias in a climb of 5 m/s, m"
    )
    print()

    t = np.arange(0.0, 3600.001, 0.05)
    channel = VerticalChannel(NetworkTheory(5.0, 0.0, W2), LATITUDE, height=START + 1.0)
    rest = np.full(len(t), float(normal_gravity(LATITUDE, START)))
    out = channel.push(np.round(t * 1e9).astype(np.int64), rest)
    print(f"1 m of height error, undamped for an hour: {out.height[-1] - START:.1f} m (277-279)\n")


@njit(cache=True, nogil=True)
def _raw_gap(f, baro, gap, interval, tau, k4, w2):  # type: ignore[no-untyped-def]
    """The network alone: A held as it was, engaged again as if nothing had been; (h, v)."""
    out = np.empty((len(f), 2))
    h, v, a = baro[0], 0.0, 0.0
    for k in range(1, len(f)):
        dv = (f[k] + w2 * h - a) * interval
        h += (v + 0.5 * dv) * interval
        v += dv
        if not gap[k]:
            # after the gap, with the interval that samples usually have
            l1, l2, l3 = pole_matched_gains(interval, tau, k4, w2)
            e = h + k4 * v - baro[k]
            h -= l1 * e
            v -= l2 * e
            a += l3 * e
        out[k, 0] = h
        out[k, 1] = v
    return out


def gap_errors(
    grade: str, tau: float, length: float, shadow: bool, runs: int, rate: float = 50.0
) -> tuple[float, float, float]:
    """RMS of height drift and velocity at the end of a gap, mean peak velocity after it."""
    t = np.arange(int((480.0 + length) * rate) + 1) / rate
    gap = (t > 400.0) & (t < 400.0 + length)
    first, last = int(400 * rate), int((400 + length) * rate) - 1
    network = NetworkTheory(tau, 0.0, W2)
    stamps = np.round(t * 1e9).astype(np.int64)
    rows = []
    for run in range(runs):
        rng = np.random.default_rng([11, run])
        sigma, time = (10.0, 500.0) if grade == "navigation" else (3.0, 300.0)
        keep = np.exp(-1.0 / (time * rate))
        drive = sigma * np.sqrt(1.0 - keep * keep) * rng.standard_normal(len(t))
        drive[0] = sigma * rng.standard_normal()
        baro = lfilter([1.0], [1.0, -keep], drive)
        white = np.sqrt(rate) * rng.standard_normal(len(t))
        if grade == "navigation":
            force = 50.0 * UG * rng.standard_normal() + 10.0 * UG * white
        else:
            baro = baro + 0.2 * np.sqrt(rate / 10.0) * rng.standard_normal(len(t))
            walk = np.cumsum(rng.standard_normal(len(t))) / np.sqrt(100.0 * rate) * 1000.0 * UG
            r = np.exp(-1.0 / (5.0 * rate))
            tilt = lfilter([0.02 * np.sqrt(1 - r * r)], [1.0, -r], rng.standard_normal(len(t)))
            force = 2000.0 * UG * rng.standard_normal() + 150.0 * UG * white + walk + tilt
        if shadow:
            channel = VerticalChannel(network, LATITUDE, grade, height=START)  # type: ignore[arg-type]
            out = channel.push(
                stamps,
                normal_gravity(LATITUDE, START) + force,
                stamps,
                np.where(gap, np.nan, START + baro),
            )
            h, v = out.height - START, out.v_up
        else:
            h, v = _raw_gap(force, baro, gap, 1.0 / rate, tau, 0.0, W2).T
        rows.append((h[last] - h[first], v[last], np.abs(v[last:]).max()))
    values = np.array(rows)
    return (*np.sqrt((values[:, :2] ** 2).mean(axis=0)), float(values[:, 2].mean()))


def print_gaps(runs: int) -> None:
    """What a gap of the barometer costs."""
    rows = []
    for (grade, tau, length, shadow), known in GAPS.items():
        ours = gap_errors(grade, tau, length, shadow, runs)
        from_tau = max(SHADOW_TAU[grade], tau) if shadow else tau
        theory = GRADES[grade].after_gap(from_tau, length)
        how = "channel" if shadow else "A held, raw"
        label = f"{grade}, {tau:g} s, {length:g} s, {how}"
        rows.append((label, numbers(ours), numbers(theory), numbers(known)))
    print_table(
        ("IMU, tau, gap, how", f"ours ({runs} runs)", "linear theory", "published"),
        rows,
        "Gap: drift of h m, v m/s at its end (RMS); peak v after it (mean)",
    )
    print()


def print_best() -> None:
    """Time constants for the least noise in the velocity."""
    cases = {
        "paper's baro, 10 ug/sqrt(Hz), 10 ug per 1000 s": (
            Sensors((10.0, 500.0), (10.0 * UG) ** 2, (10.0 * UG) ** 2 / 1000.0),
            (262.0, 0.036, 0.353, 4337.0),
        ),
        "tactical: 0.3 m at 10 Hz, 3 m over 300 s, 100 ug/sqrt(Hz), 100 ug per 1000 s": (
            Sensors(
                (3.0, 300.0),
                (100.0 * UG) ** 2,
                (100.0 * UG) ** 2 / 1000.0,
                baro_white=0.3**2 / 10.0,
            ),
            (54.0, 0.032, 0.141, 1744.0),
        ),
        "MEMS: 0.2 m at 50 Hz, 1 m over 100 s, 150 ug/sqrt(Hz), 1 mg per 100 s, tilt": (
            Sensors(
                (1.0, 100.0),
                (150.0 * UG) ** 2,
                (1000.0 * UG) ** 2 / 100.0,
                baro_white=0.2**2 / 50.0,
                tilt=(0.02, 5.0),
            ),
            (3.0, 0.086, 0.088, 1760.0),
        ),
    }
    rows = []
    for name, (sensors, known) in cases.items():
        best = minimize_scalar(
            lambda x, s=sensors: s.stationary(NetworkTheory(np.exp(x), 0.0, W2))[1, 1],
            bounds=np.log([0.5, 500.0]),
            method="bounded",
        )
        quick = sensors.stationary(NetworkTheory(2.4, 0.0, W2))
        off = np.array([0.0, 0.0, 1.0, 0.0, -1.0, 0.0])  # A less the bias
        sigma_a = np.sqrt(off @ quick @ off) / UG
        ours = (np.exp(best.x), np.sqrt(best.fun), np.sqrt(quick[1, 1]), sigma_a)
        rows.append((name, numbers(ours, ".4g"), numbers(known, ".4g")))
    print_table(
        ("sensors", "ours", "published"),
        rows,
        "Best tau s for v, sigma v there, at 2.4 s m/s, sigma A at 2.4 s ug (K4 = 0)",
    )
    print()


def main() -> None:
    """Print all tables."""
    options = parser(__doc__)
    options.add_argument("--runs", type=int, default=100, help="of each gap")
    args = options.parse_args()
    for table in (print_gains, print_poles, print_responses, print_flight, print_best):
        table()
    print_gaps(args.runs)


if __name__ == "__main__":
    main()
