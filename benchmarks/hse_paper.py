"""The printed figures of the paper on heading-sensitive error, beside what they amount to.

H. Yu et al., J. NUDT 35(4), 2013, 161-165: the signs of its equations against brute force, what
its K and lambda2 imply, table 1 with its regression, and how sure its calibration is:

    python benchmarks/hse_paper.py
"""

from __future__ import annotations

import numpy as np

from benchmarks.common import ARCSEC, numbers, print_table
from sinstool.core import rotation
from sinstool.core.earth import EARTH_RATE, earth_rate_n
from sinstool.methods.hse.statistics import fit_sinusoid, scatter
from tests.helpers.hse_exact import (
    lambda2_from_slope,
    linear_heading_error,
    slope,
    slope_gain,
)

LATITUDE = 0.49
K_PRINTED, LAMBDA2_PRINTED = 17.4 * ARCSEC, 4.2 * ARCSEC
EPSILON = np.array([2.2, 0.8, 1.2]) * ARCSEC
RATES = np.radians([20.0, 40.0, 60.0])
RUNS_AT_EACH = 3
# Three consecutive rows belong to one azimuth; the peak-to-peak value of the last column is
# missing in print.
AZIMUTH = np.repeat(np.radians([0.0, 91.8795, 181.2953, 272.8711]), 3)
POSITION = np.repeat(np.arange(4), 3)
BEFORE = np.array(
    [5.16, -19.54, -15.54, 12.26, 6.16, 13.36, -0.54, 20.96, -1.24, -8.44, -2.94, -9.64]
)
AFTER = np.array([5.38, -13.92, -10.12, 0.88, -1.62, 6.88, -4.62, 14.58, -3.52, 0.08, 5.08, 0.88])


def brute_heading_error(rate: float, heading: float, theta: float, gamma: float) -> float:
    """Estimated less true heading, rad, from eqs. (5) and (6) at many angles of whole turns."""
    C = rotation.to_dcm(rotation.from_euler([gamma, theta, heading]))
    w_n = earth_rate_n(LATITUDE)
    e = -np.ones(3) / np.sqrt(3.0)
    y = np.cross(e, [1.0, 0.0, 0.0])
    y /= np.linalg.norm(y)
    C_sb = np.stack([np.cross(y, e), y, e])
    wrong = np.eye(3) + np.array([[0, 0, 0], [EPSILON[0], 0, 0], [EPSILON[1], EPSILON[2], 0]])
    mean = np.zeros(3)
    angles = np.arange(48) * 2.0 * np.pi / 48
    for alpha in angles:
        turn = np.array(
            [[np.cos(alpha), -np.sin(alpha), 0], [np.sin(alpha), np.cos(alpha), 0], [0, 0, 1.0]]
        )
        table = np.array([0.0, 0.0, rate])
        gyro = C_sb.T @ (turn.T @ C.T @ w_n + table)
        mean += C @ turn @ (C_sb @ wrong @ gyro - table) / len(angles)
    return float(-np.arctan2(mean[1], mean[0]))


def signs() -> None:
    rate, gamma = np.radians(40.0), -8e-4
    brute, upside = (brute_heading_error(rate, 0.0, 0.0, g) for g in (gamma, -gamma))
    # half the difference: what is the same for both tilts is no heading-sensitive error
    seen = 0.5 * (brute - upside) / ARCSEC
    C23 = -gamma
    total = float(EPSILON.sum())
    horizontal = EARTH_RATE * np.cos(LATITUDE)

    def model(factor: float, sign: float) -> float:
        lambda1 = rate - factor * EARTH_RATE * np.sin(LATITUDE)
        return sign * lambda1 * total * C23 / (3.0 * horizontal) / ARCSEC

    print("## Signs and factors, at 40 deg/s, lean 8e-4, errors of 2.2, 0.8 and 1.2 arcsec\n")
    rows = (
        ("(5) and (6) by brute force, estimate less truth", seen),
        ("(12), (13) as printed, lambda2 the sum of the errors", model(1.0, 1.0)),
        ("with the sign of (12) turned", model(1.0, -1.0)),
        ("and Omega - 1.5 w sin L for lambda1", model(1.5, -1.0)),
        ("constant that stays at every azimuth", 0.5 * (brute + upside) / ARCSEC),
    )
    print_table(("", "arcsec"), ((name, f"{value:.5f}") for name, value in rows))


def implied() -> None:
    lean = lambda2_from_slope(K_PRINTED, 1.0, LATITUDE) / LAMBDA2_PRINTED
    print("\n## What K = 17.4 arcsec/(rad/s) and lambda2 = 4.2 arcsec imply\n")
    print(f"C23 at latitude 0.49 rad: {lean:.3e} rad; K of 4.2 arcsec and 8e-4 rad:", end=" ")
    print(f"{slope(LAMBDA2_PRINTED, 8e-4, LATITUDE) / ARCSEC:.3f} arcsec/(rad/s)")
    headings = numbers(K_PRINTED * RATES / ARCSEC, ".2f", ", ")
    print(f"heading at 20, 40, 60 deg/s: {headings} arcsec")
    rate = np.radians(40.0)
    for text, lambda2, tilt in (
        ("one error of 1e-5 rad, tilt 1e-3 rad", 1e-5, 1e-3),
        ("three errors of 1e-5 rad, tilt 1e-3 rad", 3e-5, 1e-3),
        ("three, and that tilt about both axes", 3e-5, np.sqrt(2.0) * 1e-3),
    ):
        value = linear_heading_error(lambda2, rate, tilt, LATITUDE) / ARCSEC
        print(f"'about 30 arcsec' at 40 deg/s, {text}: {value:.1f} arcsec")


def table_1() -> None:
    print("\n## Table 1, arcsec\n")
    columns = [(scatter(v, POSITION), fit_sinusoid(AZIMUTH, v)) for v in (BEFORE, AFTER)]
    rows = [
        ("peak to peak", [s.peak_to_peak for s, _ in columns]),
        ("standard deviation", [s.std for s, _ in columns]),
        ("peak to peak of the four means", [s.peak_to_peak_of_means for s, _ in columns]),
        ("within azimuths, pooled, 8 dof", [s.within_std for s, _ in columns]),
        ("amplitude of the sinusoid", [f.amplitude for _, f in columns]),
        ("its sigma", [f.sigma_amplitude for _, f in columns]),
        ("F(2, 9)", [f.F for _, f in columns]),
        ("p", [f.p for _, f in columns]),
    ]
    cells = ((name, *(f"{value:.3f}" for value in pair)) for name, pair in rows)
    print_table(("", "before", "after"), cells)
    taken = BEFORE - AFTER
    left = scatter(taken, POSITION)
    print(f"\nbefore less after: amplitude {fit_sinusoid(AZIMUTH, taken).amplitude:.2f}", end=", ")
    print(f"scatter within an azimuth {left.within_std:.2f}: a fixed lambda2 would not scatter")


def significance() -> None:
    within = scatter(BEFORE, POSITION).within_std
    rates = np.repeat(RATES, RUNS_AT_EACH)
    sigma = within * slope_gain(rates)
    print("\n## How sure the calibration is\n")
    print(f"scatter of a run {within:.2f} arcsec (table 1, within azimuths); at 20, 40, 60 deg/s,")
    print(f"three runs each: sigma of K {sigma:.1f} arcsec/(rad/s), K = 17.4 is", end=" ")
    print(f"{17.4 / sigma:.1f} sigma")
    both = np.concatenate([rates, -rates])
    print(f"with both directions: sigma {within * slope_gain(both):.1f},", end=" ")
    print(f"{17.4 / (within * slope_gain(both)):.1f} sigma")


def main() -> None:
    signs()
    implied()
    table_1()
    significance()


if __name__ == "__main__":
    main()
