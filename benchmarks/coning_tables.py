"""Tables of the coning algorithms in simulated motion, each from one command.

python benchmarks/coning_tables.py manoeuvres
python benchmarks/coning_tables.py single-line
python benchmarks/coning_tables.py spectrum
python benchmarks/coning_tables.py pseudo-coning
python benchmarks/coning_tables.py look-ahead

The drift table, which needs no simulation, is that of `coning_drift.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from scipy import signal

from benchmarks.common import FloatArray, parser
from benchmarks.coning_drift import DEG_PER_H, PAPER, SP, Row, Table
from sinstool.core import rotation
from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.gyro_response import GyroResponse
from sinstool.methods.coning.increments import DEFAULT_POINTS, RateIntegrator
from sinstool.methods.coning.picard import Picard
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_gains, coning_spectrum, predicted_drift
from sinstool.methods.coning.sp_tuning import best_q, coning_answer, tune
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.coning_paper import (
    DEFAULT_RESPONSE,
    NOISE_ANGLE,
    Phase,
    coning_paper,
)
from sinstool.simulation.motions import broadband, random_manoeuvre, sample
from sinstool.simulation.truth import ImuTruth, sample_times
from tests.helpers.coning_response import coning_rate
from tests.helpers.thinned import thin

RATE = 400.0
STEP = 1.0 / RATE

# The kinds of sample, and point rates that are passed off as mean rates.
Feed = Literal["increment", "mean-rate", "rate", "rate x T"]


def fed(log: ImuTruth, feed: Feed) -> tuple[FloatArray, GyroKind]:
    """Samples, and what the algorithm is told they are."""
    if feed == "increment":
        return log.gyro_increment, feed
    if feed == "mean-rate":
        return log.gyro_mean_rate, feed
    return log.gyro_rate, "rate" if feed == "rate" else "mean-rate"


def final_error(
    chosen: ConingAlgorithm,
    gyro: FloatArray,
    kind: GyroKind,
    truth: ImuTruth,
    *,
    points: int = DEFAULT_POINTS,
    first: int = 0,
) -> FloatArray:
    """``log(q_true^-1 q)`` at the end of a run that starts at the truth at row `first`, rad."""
    stage = ConingStage(chosen, kind, nominal_interval=float(truth.interval[1]), points=points)
    parts = [stage.push(gyro, truth.time_ns), stage.finish()]
    used = np.concatenate([part.sample for part in parts]) > first
    phi = np.concatenate([part.rotation_vector for part in parts])[used]
    interval = np.concatenate([part.interval for part in parts])[used]
    q = AttitudePropagator(truth.q_nb[first]).push(phi, interval)[-1]
    return rotation.log(rotation.multiply(rotation.conjugate(truth.q_nb[-1]), q))


# --- manoeuvres ---------------------------------------------------------------------------------

# rms of the rate in rad/s, band in Hz
MOTIONS = {"slow": (3.0, (0.3, 2.5)), "fast": (6.5, (1.0, 8.0))}

MANOEUVRED: tuple[tuple[str, ConingAlgorithm, Feed], ...] = (
    *(
        (name, algorithm(name), "mean-rate")
        for name in (
            *("uncompensated", "optimal-2", "optimal-4", "optimal-6", "savage-two-speed"),
            *("previous-1", "previous-3", "picard-4", "quatfiter-4", "quatfiter-6"),
            *("lookahead-8", "lookahead-12", "gyro-tuned"),
        )
    ),
    ("picard-4 after 3 integrals", Picard(4, iterations=3), "mean-rate"),
    (f"{SP} (paper), rates", algorithm(SP, preset="paper"), "rate"),
    (f"{SP} (best), rates", algorithm(SP), "rate"),
    ("optimal-4, rate x T", algorithm("optimal-4"), "rate x T"),
    ("quatfiter-4, rates", algorithm("quatfiter-4"), "rate"),
    ("lookahead-12, rates", algorithm("lookahead-12"), "rate"),
)


def manoeuvres(motions: int = 6, seconds: float = 60.0) -> list[Table]:
    columns = [(speed, rate) for speed in MOTIONS for rate in (100.0, RATE)]
    squares = {label: np.zeros(len(columns)) for label, _, _ in MANOEUVRED}
    for column, (speed, rate) in enumerate(columns):
        for seed in range(motions):
            log = sample(random_manoeuvre(*MOTIONS[speed], seed=seed), sample_times(rate, seconds))
            for label, chosen, feed in MANOEUVRED:
                error = final_error(chosen, *fed(log, feed), log)
                squares[label][column] += error @ error
    return [
        Table(
            f"Manoeuvres: rms over {motions} random motions of the error after {seconds:g} s, rad",
            tuple(f"{speed} at {rate:g} Hz" for speed, rate in columns),
            {label: tuple(np.sqrt(sums / motions)) for label, sums in squares.items()},
            ".1e",
        )
    ]


# --- singular perturbation tuned to one line ----------------------------------------------------


def single_line(line: float = 30.0, others: Sequence[float] = (10.0, 20.0, 50.0)) -> list[Table]:
    q = best_q(2.0 * np.pi * line * STEP)
    tuned = algorithm(SP, variant="truncated", epsilon=0.5 * STEP, beta_gain=6.0 * q + 1.5)
    rows = {
        "no compensation, rate x T": Row(algorithm("uncompensated"), "rate", taken_for_means=True),
        "optimal-4, rate x T": Row(algorithm("optimal-4"), "rate", taken_for_means=True),
        f"{SP} (best), rates": Row(algorithm(SP), "rate"),
        f"{SP} (n for {line:g} Hz), rates": Row(tuned, "rate"),
        "optimal-4, rates through 6 points": Row(algorithm("optimal-4"), "rate"),
        "lookahead-12, rates": Row(algorithm("lookahead-12"), "rate"),
        "previous-1, mean rates": Row(algorithm("previous-1"), "mean-rate"),
        "previous-3, mean rates": Row(algorithm("previous-3"), "mean-rate"),
    }
    at = sorted({line, *others})
    narrow = 1e-4

    def missing(row: Row) -> tuple[float, ...]:
        return tuple(row.drift(narrow, f, STEP) / coning_rate(narrow, f) for f in at)

    return [
        Table(
            f"Single-line tuning of {SP}, {RATE:g} Hz, epsilon = T/2",
            ("Q", "n"),
            {"best": (1.0 / 12.0, 2.0), f"for {line:g} Hz": (q, 6.0 * q + 1.5)},
            ".4g",
            "parameters",
        ),
        Table(
            "Part of the true coning rate that is missing, narrow cone",
            tuple(f"{f:g} Hz" for f in at),
            {label: missing(row) for label, row in rows.items()},
            ".2g",
        ),
    ]


# --- coning spectrum: prediction, and tuning to it ----------------------------------------------

# 20 to 150 Hz, of equal rate at all frequencies, coning the same way round; rms of each axis, rad
BROADBAND_RMS = 5.5e-5
PASSBAND = 160.0


def spectrum(seed: int = 1) -> list[Table]:
    # one instant less than a multiple of four, so that it thins well
    log = sample(broadband(BROADBAND_RMS, seed=seed), sample_times(RATE, 64.0 + 3 * STEP))
    content = {k: coning_spectrum(fed(log, k)[0], STEP, k) for k in ("mean-rate", "rate")}
    fit = tune(log.gyro_rate, STEP, passband=PASSBAND)

    def simulated(chosen: ConingAlgorithm, feed: Feed, every: int = 1) -> float:
        run = log if every == 1 else thin(log, every)
        error = final_error(chosen, *fed(run, feed), run)
        return float(DEG_PER_H * error[2] / (log.interval[1] * len(log.time_ns)))

    def pair(name: str, kind: GyroKind, every: int = 1, **options) -> tuple[float, float]:
        chosen = algorithm(name, **options)
        predicted = predicted_drift(content[kind], chosen, interval=every * STEP)[2]
        return simulated(chosen, kind, every), float(DEG_PER_H * predicted)

    names = ("uncompensated", "previous-1", "previous-3", "lookahead-12", "optimal-2", "optimal-4")
    rows = {f"{name}, mean rates": pair(name, "mean-rate") for name in names}
    rows["uncompensated, mean rates, 100 Hz"] = pair("uncompensated", "mean-rate", 4)
    # the rectangle rule: two rates with Q = 0
    turn = 2.0 * np.pi * content["rate"].frequency[1:] * STEP
    gain = coning_answer(turn, 0.0) - 1.0
    rows["no compensation, rate x T"] = (
        simulated(algorithm("uncompensated"), "rate x T"),
        float(DEG_PER_H * (gain @ content["rate"].density[1:, 2] * content["rate"].step)),
    )
    rows[f"{SP} (paper, printed), rates"] = pair(SP, "rate", variant="printed", **PAPER)
    rows[f"{SP} (paper, truncated), rates"] = pair(SP, "rate", variant="truncated", **PAPER)
    rows[f"{SP} (best), rates"] = pair(SP, "rate")
    rows[f"{SP} (auto), rates"] = pair(SP, "rate", **fit.options())
    return [
        Table(
            f"Spectrum tuning of {SP}, 20 to 150 Hz, passband {PASSBAND:g} Hz, epsilon = T/2",
            ("Q", "n"),
            {"best": (1.0 / 12.0, 2.0), "auto": (fit.q, fit.beta_gain)},
            ".4g",
            "parameters",
        ),
        Table(
            "Drift over 64 s about the cones' axis, deg/h",
            ("simulated", "predicted from the coning spectrum"),
            rows,
            ".4f",
        ),
    ]


# --- pseudo-coning ------------------------------------------------------------------------------

NOISE = (60.0, 100.0, 120.0, 150.0, 180.0, 199.0, 260.0)
SECONDS = 10.0
_LEAD = 40  # samples of history: a tenth of a second, whole turns of the motion


def tuned(lags: int, stopband: float | None) -> ConingAlgorithm:
    return algorithm(
        "gyro-tuned",
        passband=60.0,
        stopband=stopband,
        gyro_response=DEFAULT_RESPONSE,
        interval=STEP,
        lags=lags,
    )


def without_ripple() -> GyroResponse:
    """The gyro, but with gain 1 for the motion's 30 Hz."""

    def gain(f: FloatArray) -> FloatArray:
        return np.where(np.abs(f - 30.0) < 1.0, 1.0, DEFAULT_RESPONSE(f))

    return GyroResponse("without ripple", gain)


def pseudo_error(
    chosen: ConingAlgorithm,
    noise: float,
    feed: Feed = "increment",
    *,
    response: GyroResponse = DEFAULT_RESPONSE,
    phase: Phase = "consistent",
) -> float:
    """z error after ten seconds of 0.1 deg coning at 30 Hz with noise of 0.01 deg, degrees."""
    times = sample_times(RATE, SECONDS + _LEAD * STEP)
    truth, log = coning_paper(times, noise, response=response, phase=phase)
    return float(np.degrees(final_error(chosen, *fed(log, feed), truth, first=_LEAD)[2]))


def pseudo_coning() -> list[Table]:
    every = {name: algorithm(name) for name in ("optimal-4", "previous-1", "previous-3")} | {
        "gyro-tuned, 8 lags, 60 Hz": tuned(8, None),
        "gyro-tuned, 12 lags, 60/110 Hz": tuned(12, 110.0),
        "gyro-tuned, 16 lags, 60/100 Hz": tuned(16, 100.0),
    }

    def errors(at: Sequence[float], rows: dict[str, ConingAlgorithm], feed: Feed, **options):
        return {
            label: tuple(pseudo_error(one, f, feed, **options) for f in at)
            for label, one in rows.items()
        }

    motion = "0.1 deg at 30 Hz"
    at = (120.0, 130.0, 220.0, 230.0)
    few = {name: every[name] for name in ("optimal-4", "previous-3")}
    flat = {"response": without_ripple()}
    folding = errors(at, few, "increment", **flat)
    for label, values in errors(at, few, "rate x T", **flat).items():
        folding[f"{label}, rate x T"] = values
    real = {name: every[name] for name in ("optimal-4", "gyro-tuned, 12 lags, 60/110 Hz")}
    passband, answers = np.linspace(0.5, 60.0, 120), {}
    for label, one in every.items():
        wrong = np.abs(DEFAULT_RESPONSE(passband) ** 2 * coning_gains(one, passband, STEP) - 1.0)
        answers[label] = (float(wrong[passband == 30.0][0]), float(wrong.max()))
    return [
        *(
            Table(
                f"Pseudo-coning: z error in deg after {SECONDS:g} s of {motion} with 0.01 deg of"
                f" noise, {what}",
                tuple(f"{f:g} Hz" for f in NOISE),
                errors(NOISE, every, feed),
                "+.6f",
            )
            for feed, what in (("increment", "true increments"), ("rate", "point rates"))
        ),
        Table(
            "Error of the answer to the motion, as a part of it",
            ("at 30 Hz", "largest up to 60 Hz"),
            answers,
            ".1e",
        ),
        Table(
            "Noise that is motion and has its own z rate: z error in deg, true increments",
            tuple(f"{f:g} Hz" for f in NOISE[2:-1]),
            errors(NOISE[2:-1], real, "increment", phase="literal"),
            "+.4f",
        ),
        Table(
            "Folding at the update rate: z error in deg, gyro without ripple, true increments",
            tuple(f"{f:g} Hz" for f in at),
            folding,
            "+.4f",
        ),
        above_half(),
    ]


def above_half(at: Sequence[float] = (400.0, 430.0, 800.0)) -> Table:
    """Noise about the sampling rate: what sampling later, or integrating before, does to it."""
    optimal = algorithm("optimal-4")
    factor = 5
    edge = 200  # samples at 2 kHz: a filter's length

    def native(name: str, feed: Feed) -> Callable[[float, float], FloatArray]:
        def error(noise: float, angle: float) -> FloatArray:
            truth, log = coning_paper(sample_times(RATE, SECONDS), noise, noise_angle=angle)
            return final_error(algorithm(name), *fed(log, feed), truth)

        return error

    def fast(
        make: Callable[[ImuTruth], FloatArray], kind: GyroKind, every: int = factor
    ) -> Callable[[float, float], FloatArray]:
        def error(noise: float, angle: float) -> FloatArray:
            rate = factor * RATE
            times = sample_times(rate, SECONDS + 2 * edge / rate)
            truth, log = coning_paper(times, noise, noise_angle=angle)
            rows = slice(edge, len(times) - edge, every)
            fields = {name: value[rows] for name, value in vars(truth).items()}
            fields["interval"] = every * fields["interval"]
            return final_error(optimal, make(log)[rows], kind, ImuTruth(**fields))

        return error

    def sums(log: ImuTruth) -> FloatArray:
        rate = log.gyro_rate
        parts = RateIntegrator().increments(rate, log.interval, 1, len(rate) - 1)
        angle = np.concatenate([np.zeros((1 + factor, 3)), np.cumsum(parts, axis=0)])
        return angle[factor:] - angle[:-factor]

    def filtered(log: ImuTruth) -> FloatArray:
        taps = signal.firwin(161, 150.0, window=("kaiser", 8.0), fs=factor * RATE)
        return signal.convolve(log.gyro_rate, taps[:, np.newaxis], mode="same")

    runs = {
        f"{name}, point rates at 400 Hz": native(name, "rate")
        for name in ("optimal-4", "previous-3", SP, "gyro-tuned", "lookahead-12")
    }
    runs["optimal-4, increments at 400 Hz"] = native("optimal-4", "increment")
    runs["optimal-4, point rates at 2 kHz"] = fast(lambda log: log.gyro_rate, "rate", 1)
    runs["optimal-4, 2 kHz summed to 400 Hz"] = fast(sums, "increment")
    runs["optimal-4, 2 kHz through a 150 Hz filter to 400 Hz"] = fast(filtered, "rate")

    def added(run: Callable[[float, float], FloatArray], noise: float) -> float:
        return float(np.degrees(np.linalg.norm(run(noise, NOISE_ANGLE) - run(noise, 0.0))))

    return Table(
        f"Noise about the sampling rate: length of the error that it adds in {SECONDS:g} s, deg",
        tuple(f"{f:g} Hz" for f in at),
        {label: tuple(added(run, f) for f in at) for label, run in runs.items()},
        ".5f",
    )


# --- looking ahead ------------------------------------------------------------------------------

CONES = ((0.1, 20.0, 200.0), (1.0, 10.0, 100.0), (10.0, 1.0, 100.0))  # deg, Hz, samples a second
MINUTE = 60.0


def minute_error(
    chosen: ConingAlgorithm,
    cone: tuple[float, float, float],
    feed: Feed,
    *,
    points: int = DEFAULT_POINTS,
    noise: FloatArray | float = 0.0,
) -> float:
    """Length of the error after a minute of coning, ends of the log included, in deg/h."""
    half_angle, frequency, rate = cone
    log = classical_coning(sample_times(rate, MINUTE), np.radians(half_angle), frequency)
    gyro, kind = fed(log, feed)
    error = final_error(chosen, gyro + noise, kind, log, points=points)
    return float(DEG_PER_H * np.linalg.norm(error) / MINUTE)


MEANS = (
    "uncompensated",
    "previous-1",
    "previous-3",
    *(f"optimal-{n}" for n in range(2, 7)),
    *("picard-4", "picard-8", "lookahead-8", "lookahead-12", "lookahead-16"),
)
LINEAR = algorithm(SP, variant="bvp", epsilon=1.0, beta_gain=1.0)
RATES: dict[str, tuple[ConingAlgorithm, Feed, int]] = {
    "previous-1, rate x T": (algorithm("previous-1"), "rate x T", 0),
    "trapezoid and 1/12 of the two rates' product": (LINEAR, "rate", 0),
    f"{SP} (best)": (algorithm(SP), "rate", 0),
    "optimal-4, 6-point interpolation": (algorithm("optimal-4"), "rate", 6),
    "optimal-4, 8-point interpolation": (algorithm("optimal-4"), "rate", 8),
    "lookahead-8": (algorithm("lookahead-8"), "rate", 6),
    "lookahead-12": (algorithm("lookahead-12"), "rate", 6),
}


def look_ahead(runs: int = 12) -> list[Table]:
    columns = tuple(f"{a:g} deg, {f:g} Hz at {rate:g} Hz" for a, f, rate in CONES)
    means = {
        name: tuple(minute_error(algorithm(name), cone, "mean-rate") for cone in CONES)
        for name in MEANS
    }
    rates = {
        label: tuple(
            minute_error(chosen, cone, feed, points=points or DEFAULT_POINTS) for cone in CONES
        )
        for label, (chosen, feed, points) in RATES.items()
    }

    # 0.3 deg/sqrt(h) on the slow cone, where neither drifts by itself
    cone = CONES[2]
    sigma = np.radians(0.3) / 60.0 * np.sqrt(cone[2])
    kinds: tuple[Feed, ...] = ("mean-rate", "rate")
    walks = {name: np.zeros(len(kinds)) for name in ("previous-1", "lookahead-12")}
    for seed in range(runs):
        count = round(MINUTE * cone[2]) + 1
        noise = sigma * np.random.default_rng(seed).normal(size=(count, 3))
        for name, total in walks.items():
            for i, kind in enumerate(kinds):
                total[i] += minute_error(algorithm(name), cone, kind, noise=noise) ** 2
    return [
        Table("Look-ahead: error over a minute in deg/h, mean rates", columns, means, ".3g"),
        Table("The same, point rates", columns, rates, ".3g"),
        Table(
            f"Error over a minute from 0.3 deg/sqrt(h) of noise, rms of {runs} runs, deg/h",
            ("mean rates", "point rates"),
            {name: tuple(np.sqrt(total / runs)) for name, total in walks.items()},
            ".2f",
        ),
    ]


TABLES: dict[str, Callable[[], list[Table]]] = {
    "manoeuvres": manoeuvres,
    "single-line": single_line,
    "spectrum": spectrum,
    "pseudo-coning": pseudo_coning,
    "look-ahead": look_ahead,
}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("table", choices=(*TABLES, "all"))
    chosen = options.parse_args().table
    for name in TABLES if chosen == "all" else (chosen,):
        for table in TABLES[name]():
            print(table)


if __name__ == "__main__":
    main()
