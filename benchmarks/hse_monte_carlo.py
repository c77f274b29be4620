"""Monte Carlo of the calibration of heading-sensitive error, ours beside what is expected.

python benchmarks/hse_monte_carlo.py full --sets 60      # 9 logs of 300000 samples a set
python benchmarks/hse_monte_carlo.py fast --sets 4000    # runs drawn turn by turn
python benchmarks/hse_monte_carlo.py validation          # calibration, then four azimuths
python benchmarks/hse_monte_carlo.py plan                # designs of a calibration

`full` simulates the samples of a rig of lasers on a turntable, aligns every log on whole turns
and fits them; `fast` draws only the heading of each turn. `validation` does to simulated runs
what Yu et al., J. NUDT 35(4), 2013, did to theirs for table 1: correct three headings at each
of four azimuths with a coefficient found before.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.common import (
    ARCSEC,
    DEG_H,
    DEG_SQRT_H,
    UG,
    FloatArray,
    over_seeds,
    parser,
    print_table,
)
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.hse.design import Design, predict
from sinstool.methods.hse.encoder import table_angle
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions, HseFit
from sinstool.methods.hse.rig import EncoderModel, Rig
from sinstool.methods.hse.run import HseRun
from sinstool.methods.hse.segments import SegmentRules, find_segments, turn_statistics
from sinstool.methods.hse.whole_turn import run_from_turns
from sinstool.simulation.hse_rig import HseRigErrors, HseRigSetup, hse_rig
from tests.helpers.hse_exact import slope_gain

LATITUDE = 0.49
EPSILON = np.array([2.2, 0.8, 1.2]) * ARCSEC
LAMBDA2 = -float(EPSILON.sum())
C23 = 8e-4
DURATION = 600.0
ARW = 5e-4 * DEG_SQRT_H
RATES = np.radians([20.0, 40.0, 60.0])
HORIZONTAL = EARTH_RATE * np.cos(LATITUDE)


@dataclass(frozen=True)
class Outcome:
    """What the fits of one set of runs gave."""

    K: float
    sigma_K: float
    held_K: bool
    lambda2: float
    sigma_lambda2: float
    held_lambda2: bool
    axial: float
    sigma_axial: float
    held_axial: bool
    axial_plain: float
    heading_error: tuple[float, ...]
    turn_sigma: tuple[float, ...]
    rejected: int


def outcome(runs: Sequence[HseRun], true_heading: float) -> Outcome:
    """Fit a set of runs with the defaults and compare with the truth."""
    heading = fit(runs, FitOptions(method="heading"))
    axial = fit(runs, FitOptions(method="axial"))
    true_k = LAMBDA2 * C23 / (3.0 * HORIZONTAL)
    assert heading.K is not None and heading.sigma_K is not None
    assert heading.lambda2 is not None and heading.sigma_lambda2 is not None
    true = [true_heading + (r.rate - EARTH_RATE * np.sin(LATITUDE)) * true_k for r in runs]
    error = [
        (r.heading - t + np.pi) % (2.0 * np.pi) - np.pi for r, t in zip(runs, true, strict=True)
    ]
    return Outcome(
        K=heading.K,
        sigma_K=heading.sigma_K,
        held_K=_held(heading.ci95_K, true_k),
        lambda2=heading.lambda2,
        sigma_lambda2=heading.sigma_lambda2,
        held_lambda2=_held(heading.ci95_lambda2, LAMBDA2),
        axial=axial.axial.lambda2,
        sigma_axial=axial.axial.sigma_lambda2,
        held_axial=_held(axial.ci95_lambda2, LAMBDA2),
        axial_plain=float(np.mean([-3.0 * r.c_axial for r in runs])),
        heading_error=tuple(error),
        turn_sigma=tuple(r.sigma_heading for r in runs),
        rejected=_rejected(heading),
    )


def _held(interval: tuple[float, float] | None, true: float) -> bool:
    return interval is not None and interval[0] <= true <= interval[1]


def _rejected(result: HseFit) -> int:
    return sum(one.reason.startswith("outlier") for one in result.run_fits)


def full_set(seed: int, duration: float = DURATION, rate_hz: float = 500.0) -> Outcome:
    """Nine logs of one system, sample by sample, aligned and fitted."""
    random = np.random.default_rng(seed)
    heading = 0.7
    setup = HseRigSetup(
        latitude=LATITUDE,
        heading=heading,
        theta=C23 * np.sin(heading),
        gamma=-C23 * np.cos(heading),
        epsilon=tuple(EPSILON),
        imu_rate=rate_hz,
        encoder_rate=rate_hz,
    )
    gyro_bias = 0.003 * DEG_H * random.standard_normal(3)
    accel_bias = 50.0 * UG * random.standard_normal(3)
    runs = []
    for i, rate in enumerate(np.tile(RATES, 3)):
        errors = HseRigErrors(
            angle_random_walk=ARW,
            gyro_bias=tuple(gyro_bias),
            gyro_drift=0.001 * DEG_H,
            velocity_random_walk=10.0 * UG,
            accel_bias=tuple(accel_bias),
            encoder_lsb=0.18 * ARCSEC,
            ripple=1e-4,
        )
        log = hse_rig([(rate, duration)], setup, errors, seed=1000 * seed + i)
        rig = Rig(
            K_g=log.believed_K_g,
            C_s_to_b=log.believed_C_s_to_b,
            latitude=LATITUDE,
            encoder=EncoderModel(joint="table"),
        )
        pieces = table_angle(log.time_ns, log.encoder_time_ns, log.encoder_position, rig.encoder)
        rules = SegmentRules(settle_s=0.0, align_duration_s=duration)
        segment = find_segments(pieces, rules).used[0]
        turns = turn_statistics(pieces[segment.piece], segment, log.gyro, log.accel)
        runs.append(run_from_turns(turns, rig, id=str(i), source=f"{i}.mcap"))
    return outcome(runs, heading)


def fast_set(seed: int, rates: FloatArray | None = None) -> Outcome:
    """Runs whose turns are drawn instead of summed, fitted."""
    random = np.random.default_rng(seed)
    bias = 0.003 * DEG_H * random.standard_normal()
    runs = []
    for i, rate in enumerate(np.tile(RATES, 3) if rates is None else rates):
        n = int(abs(rate) * DURATION / (2.0 * np.pi))
        turn = 2.0 * np.pi / abs(rate)
        noise = ARW / np.sqrt(turn) * random.standard_normal((n, 2))
        noise[:, 1] += bias + 0.001 * DEG_H * random.standard_normal()
        along = rate - EARTH_RATE * np.sin(LATITUDE)
        hse = along * LAMBDA2 * C23 / (3.0 * HORIZONTAL)
        per_turn = 0.7 + hse - noise[:, 0] / HORIZONTAL
        runs.append(
            HseRun(
                id=str(i),
                source=f"{i}.mcap",
                t_start_s=0.0,
                duration_s=n * turn,
                n_turns=n,
                rate=float(rate),
                heading=float(per_turn.mean()),
                sigma_heading=float(per_turn.std(ddof=1) / np.sqrt(n)),
                theta=C23 * float(np.sin(0.7)),
                gamma=-C23 * float(np.cos(0.7)),
                C23=C23 + 0.09 * ARCSEC * random.standard_normal(),
                sigma_C23=0.09 * ARCSEC,
                c_axial=float(-LAMBDA2 / 3.0 + noise[:, 1].mean() / along),
                sigma_c_axial=float(noise[:, 1].std(ddof=1) / np.sqrt(n) / abs(along)),
                latitude=LATITUDE,
                per_turn_heading=per_turn,
            )
        )
    return outcome(runs, 0.7)


@dataclass(frozen=True)
class Line:
    """A quantity over all sets."""

    name: str
    mean: float
    standard_error: float
    sigma: float
    formal: float
    held: float


def summary(outcomes: Sequence[Outcome]) -> list[Line]:
    """Figures over sets, arc seconds (and rad/s)."""

    def line(name: str, value: str, formal: str | None, held: str | None) -> Line:
        x = np.array([getattr(o, value) for o in outcomes]) / ARCSEC
        s = np.array([getattr(o, formal) if formal else np.nan for o in outcomes]) / ARCSEC
        h = np.mean([getattr(o, held) for o in outcomes]) if held else np.nan
        sigma = float(x.std(ddof=1))
        return Line(
            name,
            float(x.mean()),
            sigma / np.sqrt(len(x)),
            sigma,
            float(np.sqrt(np.mean(s * s))),
            float(h),
        )

    return [
        line('K, "/(rad/s)', "K", "sigma_K", "held_K"),
        line('lambda2 from headings, "', "lambda2", "sigma_lambda2", "held_lambda2"),
        line('lambda2 axial, bias fitted, "', "axial", "sigma_axial", "held_axial"),
        line('lambda2 axial, plain mean, "', "axial_plain", None, None),
    ]


def expected() -> tuple[float, float, float, float]:
    """1 sigma of each line of :func:`summary`, arc seconds: white noise, and the bias."""
    noise = ARW / np.sqrt(DURATION)
    rates = np.tile(RATES, 3)
    k = slope_gain(rates) * noise / HORIZONTAL
    drift = np.hypot(noise, 0.001 * DEG_H)
    bias = 0.003 * DEG_H * np.mean(1.0 / rates)
    plain = 3.0 * np.hypot(bias, np.sqrt(np.sum((drift / rates) ** 2)) / len(rates))
    axial = 3.0 * drift * slope_gain(rates)
    return (
        k / ARCSEC,
        3.0 * HORIZONTAL * k / C23 / ARCSEC,
        axial / ARCSEC,
        float(plain / ARCSEC),
    )


@dataclass(frozen=True)
class Scenario:
    """Calibration at three repeats of each rate, then runs at four azimuths."""

    name: str
    lambda2: float
    tilt: float
    arw_deg_sqrt_h: float
    rates_deg_s: tuple[float, ...] = (20.0, 40.0, 60.0)
    axial: bool = False


ONE_WAY = (20.0, 40.0, 60.0)
BOTH_WAYS = (20.0, 40.0, 60.0, -20.0, -40.0, -60.0)
SCENARIOS = (
    Scenario('4.2", 8e-4, ARW 5e-4', 4.2 * ARCSEC, 8e-4, 5e-4),
    Scenario('4.2", 8e-4, ARW 2.5e-4', 4.2 * ARCSEC, 8e-4, 2.5e-4),
    Scenario('4.2", 8e-4, ARW 1e-4', 4.2 * ARCSEC, 8e-4, 1e-4),
    Scenario('4.2", 8e-4, ARW 5e-4, both directions', 4.2 * ARCSEC, 8e-4, 5e-4, BOTH_WAYS),
    Scenario('4.2", 8e-4, ARW 5e-4, axial', 4.2 * ARCSEC, 8e-4, 5e-4, ONE_WAY, True),
    Scenario("3e-5, 1.41e-3, ARW 5e-4", 3e-5, np.sqrt(2.0) * 1e-3, 5e-4),
    Scenario('4.2", 8e-3, ARW 5e-4', 4.2 * ARCSEC, 8e-3, 5e-4),
    Scenario('4.2", 8e-3, both directions', 4.2 * ARCSEC, 8e-3, 5e-4, BOTH_WAYS),
)
# Of an independent simulation with 4000 trials: HSE amplitude, then before and after of
# peak-to-peak, that of the four means, rms, median amplitude of the sinusoid; rms of what
# heading-sensitive error is left; share of trials in which the peak-to-peak value falls.
REFERENCE = (
    (12.15, 68, 71, 31, 34, 20.7, 21.9, 14.4, 14.5, 11.1, 0.46),
    (12.15, 42.5, 35.6, 25, 17, 12.8, 11.0, 12.9, 7.3, 5.4, 0.78),
    (12.15, 30.7, 14.3, 24, 6.9, 9.4, 4.4, 12.2, 2.9, 2.2, 0.996),
    (12.15, 68, 62, 31, 24, 20.7, 19.0, 14.7, 9.7, 2.9, 0.68),
    (12.15, 68, 62, 31, 23, 20.8, 18.9, 14.6, 9.2, 0.03, 0.68),
    (31.65, 98, 71, 64, 34, 29.4, 22.0, 32.6, 14.7, 10.8, 0.89),
    (121.5, 275, 71, 243, 34, 88, 21.8, 122, 14.7, 10.8, 1.00),
    (121.5, 275, 63, 243, 23, 88, 19.2, 122, 9.7, 2.9, 1.00),
)
COLUMNS = (
    *("HSE", "p-p", "after", "of means", "after", "rms", "after", "amplitude", "after"),
    *("left", "P(falls)"),
)


def validate(scenario: Scenario, trials: int, seed: int) -> tuple[float, ...]:
    """Figures of one scenario in the order of ``REFERENCE``; arc seconds."""
    random = np.random.default_rng(seed)
    noise = scenario.arw_deg_sqrt_h * DEG_SQRT_H / np.sqrt(DURATION)
    sigma = noise / HORIZONTAL
    rates = np.radians(np.repeat(scenario.rates_deg_s, 3))
    if scenario.axial:
        bias = 0.003 * DEG_H * random.standard_normal((trials, 1))
        rate_error = bias + noise * random.standard_normal((trials, len(rates)))
        fitted = scenario.lambda2 + 3.0 * (rate_error / rates).mean(axis=1)
    else:
        # the slope of a straight line through the calibration's headings
        x = (rates - EARTH_RATE * np.sin(LATITUDE)) * scenario.tilt / (3.0 * HORIZONTAL)
        headings = scenario.lambda2 * x + sigma * random.standard_normal((trials, len(rates)))
        centred = x - x.mean()
        fitted = headings @ centred / (centred @ centred)
    position = np.repeat(np.arange(4), 3)
    azimuth = 0.5 * np.pi * position
    lean = scenario.tilt * np.cos(azimuth)  # the calibration was made where it leans most
    gain = (np.radians(40.0) - EARTH_RATE * np.sin(LATITUDE)) * lean / (3.0 * HORIZONTAL)
    before = scenario.lambda2 * gain + sigma * random.standard_normal((trials, 12))
    after = before - fitted[:, None] * gain
    left = (scenario.lambda2 - fitted[:, None]) * gain
    figures = [_figures(before), _figures(after)]
    mixed = [value for pair in zip(*figures, strict=True) for value in pair]
    falls = np.mean(np.ptp(after, axis=1) < np.ptp(before, axis=1))
    amplitude = scenario.lambda2 * scenario.tilt * np.radians(40.0) / (3.0 * HORIZONTAL)
    return (
        amplitude / ARCSEC,
        *(m / ARCSEC for m in mixed),
        float(np.sqrt(np.mean(left**2)) / ARCSEC),
        float(falls),
    )


def _figures(values: FloatArray) -> tuple[float, float, float, float]:
    """Mean peak-to-peak, of the means, rms of all, median amplitude; values (trials, 12)."""
    means = values.reshape(-1, 4, 3).mean(axis=2)
    # four azimuths a quarter turn apart: the sinusoid's columns are orthogonal
    cosine, sine = (means[:, 0] - means[:, 2]) / 2.0, (means[:, 1] - means[:, 3]) / 2.0
    return (
        float(np.ptp(values, axis=1).mean()),
        float(np.ptp(means, axis=1).mean()),
        float(np.sqrt(np.mean(values**2))),
        float(np.median(np.hypot(cosine, sine))),
    )


def _print_sets(outcomes: Sequence[Outcome], seconds: float) -> None:
    truth = f'lambda2 {LAMBDA2 / ARCSEC:.4f}"'
    print(f"{len(outcomes)} sets of 9 runs in {seconds:.1f} s; truth: {truth},")
    print(f'K {LAMBDA2 * C23 / (3.0 * HORIZONTAL) / ARCSEC:.3f} "/(rad/s)\n')
    rows = (
        (
            line.name,
            f"{line.mean:.4f} +- {line.standard_error:.4f}",
            *(f"{value:.4f}" for value in (line.sigma, theory, line.formal)),
            f"{100 * line.held:.1f} %",
        )
        for line, theory in zip(summary(outcomes), expected(), strict=True)
    )
    head = ("", "mean", "1 sigma", "expected", "formal sigma, rms", "interval held")
    print_table(head, rows)
    error = np.array([o.heading_error for o in outcomes]) / ARCSEC
    turns = np.array([o.turn_sigma for o in outcomes]) / ARCSEC
    offset = error.mean()
    one = np.sqrt(np.mean((error - offset) ** 2))
    theory = ARW / np.sqrt(DURATION) / HORIZONTAL / ARCSEC
    print(
        f'\none run: heading offset {offset:.2f}", 1 sigma {one:.2f}", by the scatter of turns'
        f' {np.sqrt(np.mean(turns**2)):.2f}", expected {theory:.2f}"'
    )
    share = np.mean([o.rejected > 0 for o in outcomes])
    print(f"sets of sound runs with one left out as an outlier: {100 * share:.1f} % (1 % or less)")


def _print_validation(trials: int, seed: int) -> None:
    def rows() -> Iterator[list[str]]:
        for scenario, reference in zip(SCENARIOS, REFERENCE, strict=True):
            for name, values in (
                (scenario.name, validate(scenario, trials, seed)),
                ("", reference),
            ):
                yield [name, *(f"{v:.4g}" for v in values)]

    title = f"{trials} trials; arc seconds; each second line is an independent simulation"
    print_table(("calibration", *COLUMNS), rows(), title)


def _print_plans() -> None:
    plans = (
        ("20/40/60 x 3", ONE_WAY, 3, 1.170),
        ("+-20/40/60 x 3", BOTH_WAYS, 3, 0.313),
        ("+-60 x 3", (60.0, -60.0), 3, 0.390),
        ("+-60 x 9", (60.0, -60.0), 9, 0.225),
        ("20 to 60 by 10 x 2", (20.0, 30.0, 40.0, 50.0, 60.0), 2, 1.281),
        ("20/60 x 4", (20.0, 60.0), 4, 1.013),
    )
    rows = []
    for name, rates, repeats, value in plans:
        turning = tuple(np.radians(rates))
        sigmas = [
            predict(Design(turning, repeats, DURATION, (lean,), ARW, LATITUDE))
            for lean in (C23, 8e-3)
        ]
        ours = slope_gain(np.repeat(turning, repeats))
        cells = [f'{(s.sigma_lambda2_heading or np.nan) / ARCSEC:.3f}"' for s in sigmas]
        rows.append((name, sigmas[0].n_runs, f"{ours:.3f}", f"{value:.3f}", *cells))
    runs, sigma = "sigma_K / sigma_run", "sigma of lambda2, lean 8e-4"
    print_table(("deg/s", "runs", runs, "expected", sigma, "8e-3"), rows)


def main() -> None:
    options = parser(__doc__, seed=1, processes=2)
    options.add_argument("what", choices=("full", "fast", "validation", "plan"))
    options.add_argument("--sets", type=int, help="of nine runs (60 full, 4000 fast)")
    options.add_argument("--trials", type=int, default=4000, help="of validation")
    args = options.parse_args()
    if args.what == "validation":
        _print_validation(args.trials, args.seed)
    elif args.what == "plan":
        _print_plans()
    else:
        one = full_set if args.what == "full" else fast_set
        sets = args.sets or (60 if args.what == "full" else 4000)
        start = time.perf_counter()
        seeds = range(args.seed, args.seed + sets)
        outcomes = over_seeds(one, seeds, args.processes, chunk=max(1, min(50, sets // 8)))
        _print_sets(outcomes, time.perf_counter() - start)


if __name__ == "__main__":
    main()
