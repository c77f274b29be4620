"""Comparison on coning whose drift is known in closed form, and verdicts on made-up drifts."""

import numpy as np
import pytest

from sinstool.methods.coning.registry import algorithm
from sinstool.pipelines.compare_coning.compare import (
    DEFAULT_ALGORITHMS,
    JUDGES,
    Settings,
    compare,
)
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H, DriftStatistics, Row
from sinstool.pipelines.compare_coning.runs import Attitudes, Candidate, Segment
from sinstool.pipelines.compare_coning.verdict import MARGIN, SAME_COST, verdict
from sinstool.simulation.motions import random_manoeuvre, sample
from sinstool.simulation.truth import sample_times
from tests.helpers.coning_response import coning_drift, coning_samples

STEP = 0.01
HALF, FREQUENCY = np.radians(1.0), 5.0
INCREMENTS = tuple(n for n in DEFAULT_ALGORITHMS if n != "singular-perturbation")


def coning(seconds=60.0, kind="mean-rate"):
    count = round(seconds / STEP) + 1
    times = 10**18 + 10_000_000 * np.arange(count)
    return Segment(times, coning_samples(HALF, FREQUENCY, STEP, count, kind))


def truth(segment):
    """Attitude of the cone of `coning_samples`."""
    turn = 2 * np.pi * FREQUENCY * STEP * np.arange(len(segment))
    zero = np.zeros_like(turn)
    q = [zero + np.cos(HALF / 2), np.sin(HALF / 2) * np.cos(turn), np.sin(HALF / 2) * np.sin(turn)]
    n = len(turn)
    return Attitudes(np.arange(n), np.stack([*q, zero], -1), 0.0, n)


def closed(name, kind="mean-rate", m=1):
    """Drift about z in deg/h: towards the mean of the gyro's z axis, which is negative."""
    return -coning_drift(algorithm(name), HALF, FREQUENCY, m * STEP, kind) * IN_DEG_H


def manoeuvre(seconds=30.0, seed=0, rate=2.0):
    motion = sample(random_manoeuvre(rate, (0.3, 3.0), seed=seed), sample_times(100.0, seconds))
    n = len(motion.time_ns)
    at = Attitudes(np.arange(n), motion.q_nb, 0.0, n)
    return Segment(motion.time_ns, motion.gyro_mean_rate), at


@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
def test_drift_from_the_truth_is_that_of_the_closed_form(kind):
    segment = coning(kind=kind)
    # windows of whole turns; the first is left to what starts without history
    actual = compare([segment], kind, STEP, Settings(INCREMENTS, decimate=(1,)), [truth(segment)])
    assert actual.reference == "truth"
    assert actual.reference_resolution is None
    assert [r.candidate.name for r in actual.rows] == list(INCREMENTS)
    for row in actual.rows:
        drift = np.median(row.curves[0].window_slope[1:-1, 2]) * IN_DEG_H
        expected = closed(row.candidate.name, kind)
        assert drift == pytest.approx(expected, rel=2e-3, abs=2e-5), row.candidate.name
        assert row.drift_dph.windows == 6


def test_sums_drift_as_a_slower_log_would():
    segment = coning()
    names = ("uncompensated", "previous-1", "optimal-2")
    actual = compare(
        [segment], "mean-rate", STEP, Settings(names, decimate=(1, 2, 4)), [truth(segment)]
    )
    assert len(actual.rows) == 9
    for row in actual.rows:
        drift = row.curves[0].window_slope[1:-1, 2] * IN_DEG_H
        expected = closed(row.candidate.name, "mean-rate", row.candidate.decimate)
        np.testing.assert_allclose(drift, expected, rtol=5e-3)
        assert row.update_hz == pytest.approx(100.0 / row.candidate.stride)


@pytest.mark.parametrize("reference", ["auto", "previous-3", "lookahead-12"])
def test_divergence_from_an_algorithm_is_the_difference_of_both(reference):
    segment = coning()
    names = ("uncompensated", "previous-1", "savage-two-speed")
    actual = compare([segment], "mean-rate", STEP, Settings(names, reference, decimate=(1,)))
    known = "quatfiter-4" if reference == "auto" else reference
    assert actual.reference == known
    for row in actual.rows:
        # in axes of the body at the start, which is a degree off the cone's axis
        slopes = row.curves[0].window_slope[1:-1] @ [0.0, np.sin(HALF), np.cos(HALF)]
        expected = closed(row.candidate.name) - closed(known)
        assert np.median(slopes) * IN_DEG_H == pytest.approx(expected, rel=1e-4)
    # judges are asked though nobody named them, and two that agree prove the third wrong
    apart = [
        abs(closed(j) - closed(known))
        for j in ("quatfiter-4", "previous-3", "lookahead-12")
        if j != known
    ]
    assert actual.reference_resolution * IN_DEG_H == pytest.approx(
        max(apart) if reference == "auto" else min(apart), rel=0.05
    )


def test_a_judge_that_omits_a_term_is_no_judge_of_manoeuvres():
    """Wide and slow turns: what previous-3 omits is a hundred times what the others differ by."""
    segment, true = manoeuvre(rate=1.0)
    settings = Settings(JUDGES, decimate=(1,))
    result = compare([segment], "mean-rate", 0.01, settings)
    drift = {r.candidate.name: r.drift_dph.slope_rms for r in result.rows}
    assert drift["lookahead-12"] < 0.1 * drift["previous-3"]
    assert result.reference_resolution * IN_DEG_H == pytest.approx(drift["lookahead-12"])
    actual = compare([segment], "mean-rate", 0.01, settings, [true]).rows
    error = {r.candidate.name: r.drift_dph.slope_rms for r in actual}
    assert error["quatfiter-4"] < 1.1 * drift["lookahead-12"] < 0.1 * error["previous-3"]


def test_reference_is_judged_by_another_interpolation_too():
    # noise up to half the rate: two algorithms on the same six points agree, a third does not
    rng = np.random.default_rng(1)
    gyro = 0.3 * rng.standard_normal((6001, 3))
    segment = Segment(5_000_000 * np.arange(6001), gyro)
    names = ("previous-3", "quatfiter-4", "lookahead-12")
    result = compare([segment], "rate", 0.005, Settings(names, decimate=(1,)))
    drift = {r.candidate.name: r.drift_dph.slope_rms for r in result.rows}
    assert drift["quatfiter-4"] == 0.0
    assert drift["lookahead-12"] > 2.0 * drift["previous-3"] > 0.0
    assert result.reference_resolution * IN_DEG_H == pytest.approx(drift["lookahead-12"])
    assert result.verdict.algorithm is None
    assert result.verdict.text.startswith("This log cannot tell which algorithm is accurate to")


def test_nothing_is_compared_across_a_gap():
    # two stretches of different motion, a second apart: as if each was alone
    first, _ = manoeuvre(30.0, 1)
    second, _ = manoeuvre(20.0, 2, 1.0)
    late = Segment(second.time_ns + first.time_ns[-1] + 10**9, second.gyro)
    settings = Settings(("uncompensated", "optimal-4"), decimate=(1, 2))
    both = compare([first, late], "mean-rate", STEP, settings)
    alone = [compare([s], "mean-rate", STEP, settings) for s in (first, late)]
    assert both.segments == 2
    assert both.duration_s == pytest.approx(50.0, abs=0.02)
    for row, a, b in zip(both.rows, alone[0].rows, alone[1].rows, strict=True):
        assert len(row.curves) == 2
        apart = [*a.curves[0].window_rate, *b.curves[0].window_rate]
        listed = [*row.curves[0].window_rate, *row.curves[1].window_rate]
        np.testing.assert_array_equal(listed, apart)
        assert row.drift_dph.windows == 5
        np.testing.assert_allclose(row.end_deg, a.end_deg + b.end_deg, rtol=1e-12)
        assert row.largest_deg == max(a.largest_deg, b.largest_deg)
    pair = both.pairs["uncompensated", "optimal-4"]
    assert pair == max(a.pairs["uncompensated", "optimal-4"] for a in alone)


def test_a_short_stretch_does_not_count_as_a_window():
    long, _ = manoeuvre(30.0, 1)
    rng = np.random.default_rng(0)
    times = long.time_ns[-1] + 10**9 + 10_000_000 * np.arange(30)
    wild = Segment(times, 5.0 * rng.standard_normal((30, 3)))
    settings = Settings(("uncompensated", "previous-1"), decimate=(1,))
    alone = compare([long], "mean-rate", STEP, settings)
    both = compare([long, wild], "mean-rate", STEP, settings)
    for row, other in zip(both.rows, alone.rows, strict=True):
        assert row.drift_dph.windows == 3
        assert row.drift_dph.slope_rms == other.drift_dph.slope_rms
        assert row.largest_deg > other.largest_deg  # it is not forgotten


def test_stretches_too_short_for_anything_are_left_out_and_said():
    long, _ = manoeuvre(12.0)
    short = Segment(long.time_ns[:8] + 10**12, long.gyro[:8])
    result = compare([short, long], "mean-rate", STEP, Settings(("uncompensated",), decimate=(1,)))
    assert result.segments == 1
    (left_out,) = result.findings
    assert left_out.kind == "short-stretches" and left_out.numbers == {"samples": 8}
    with pytest.raises(ValueError, match="long enough"):
        compare([short], "mean-rate", STEP, Settings())


def test_without_a_reference_there_are_pairs_only():
    segment, _ = manoeuvre()
    names = ("uncompensated", "previous-1", "optimal-2")
    result = compare([segment], "mean-rate", STEP, Settings(names, "none", decimate=(1, 2)))
    assert all(r.drift_dph is None and not r.resolved for r in result.rows)
    assert len(result.pairs) == 3
    assert result.pairs["uncompensated", "previous-1"] > 1e-3
    assert result.verdict.algorithm is None
    assert "Without a reference" in result.verdict.text


def test_pairs_of_long_runs_are_thinned_to_shared_instants(monkeypatch):
    segment, _ = manoeuvre(60.0)
    names = ("uncompensated", "optimal-3", "optimal-4")
    settings = Settings(names, decimate=(1,))
    whole = compare([segment], "mean-rate", STEP, settings)
    monkeypatch.setattr("sinstool.pipelines.compare_coning.compare._MOST_ROWS", 50)
    few = compare([segment], "mean-rate", STEP, settings)
    for pair, angle in whole.pairs.items():
        assert 0.5 * angle < few.pairs[pair] <= angle * (1 + 1e-12)


def test_same_answers_every_time():
    segment, _ = manoeuvre()
    settings = Settings(decimate=(1, 2))
    runs = [compare([segment], "mean-rate", STEP, settings) for _ in range(2)]
    for a, b in zip(runs[0].rows, runs[1].rows, strict=True):
        assert a.candidate.label == b.candidate.label
        assert a.drift_dph.slope_rms == b.drift_dph.slope_rms
    assert runs[0].pairs == runs[1].pairs


def test_progress_ends_short_of_one():
    segment, _ = manoeuvre(12.0)
    fractions = []
    compare(
        [segment],
        "mean-rate",
        STEP,
        Settings(("uncompensated",), decimate=(1,)),
        None,
        fractions.append,
    )
    assert fractions == sorted(fractions)
    assert 0.5 < fractions[-1] < 1.0


# -- verdicts ---------------------------------------------------------------------------------

NAN = np.full(3, np.nan)


def row(name, drift, cost=50.0, windows=10, decimate=1):
    """A candidate with that drift, deg/h."""
    chosen = algorithm(name)
    result = None
    if drift is not None:
        zero = np.zeros(3)
        result = DriftStatistics(windows, zero, zero, zero, zero, zero, drift, drift)
    candidate = Candidate(name, chosen, decimate, "none" if decimate == 1 else "sums")
    return Row(candidate, 400.0 / candidate.stride, result, NAN, NAN, 0.0, cost, True, ())


def judged(rows, resolution=0.002, tolerance=0.01, reference="quatfiter-4"):
    known = None if resolution is None else resolution / IN_DEG_H
    return verdict(rows, reference, known, tolerance / IN_DEG_H)


def test_all_agree():
    result = judged(
        [row("uncompensated", 0.004), row("previous-1", 0.003), row("optimal-4", 0.009)]
    )
    assert result.agree
    assert "choice does not matter" in result.text
    assert result.algorithm == "previous-1"


def test_one_clear_winner():
    rows = [row("uncompensated", 5.0), row("previous-1", 0.3), row("previous-3", 0.006)]
    result = judged(rows)
    assert result.algorithm == "previous-3"
    assert not result.agree
    assert result.text == (
        "previous-3 is cheap and within 0.01 deg/h of quatfiter-4."
        " Larger drift: uncompensated 5, previous-1 0.3 deg/h"
    )


def test_an_uncertain_reference_names_no_algorithm():
    """As on a log whose reference was good to 75 deg/h: nothing is within 149 deg/h of it."""
    rows = [row("uncompensated", 5.0), row("previous-1", 0.3), row("previous-3", 0.15)]
    result = judged(rows, resolution=0.2)
    assert result.limit_dph == pytest.approx(MARGIN * 0.2)
    assert result.algorithm is None and not result.agree
    assert result.text == (
        "This log cannot tell which algorithm is accurate to 0.01 deg/h, as the reference,"
        " quatfiter-4, is itself uncertain by about 0.4 deg/h. Only larger differences show:"
        " uncompensated 5 deg/h. The others cannot be told apart, and previous-3, the default, is"
        " among them"
    )
    none = judged(rows, resolution=3.0)
    assert none.algorithm is None and not none.agree
    assert none.text.endswith(
        "uncertain by about 6 deg/h. No two of them differ by more than that, and previous-3, the"
        " default, is among them"
    )
    one = judged([*rows[:2], row("optimal-4", 0.01)], resolution=0.1)
    assert one.text.endswith("previous-1 0.3 deg/h. Only optimal-4 is within that uncertainty")
    worse = judged(rows, resolution=0.01)
    assert worse.text.endswith("uncompensated 5, previous-1 0.3, previous-3 0.15 deg/h")


def test_the_reference_has_to_be_twice_as_good_as_the_tolerance():
    rows = [row("uncompensated", 5.0), row("previous-3", 0.001)]
    assert judged(rows, resolution=0.0049).algorithm == "previous-3"
    assert judged(rows, resolution=0.0051).algorithm is None
    close = [row("uncompensated", 0.004), row("previous-1", 0.003)]
    assert judged(close, resolution=0.0049).agree
    assert not judged(close, resolution=0.0051).agree


def test_the_reference_is_no_candidate_of_its_own():
    rows = [row("quatfiter-4", 0.0, 10.0), row("uncompensated", 5.0), row("previous-1", 0.3)]
    result = judged(rows)
    assert result.algorithm == "quatfiter-4"
    assert result.text.startswith("None of the others is within 0.01 deg/h of quatfiter-4: ")
    good = judged([*rows, row("previous-3", 0.005)])
    assert good.algorithm == "previous-3"
    assert "so is" not in good.text and "so are" not in good.text


def test_cheap_then_often_then_close():
    rows = [
        row("optimal-4", 0.001, 30.0),
        row("previous-1", 0.005, 60.0),
        row("previous-3", 0.004, 70.0),
        row("lookahead-12", 0.0001, 1000.0),
        row("uncompensated", 1.0, 20.0),
    ]
    assert judged(rows).algorithm == "previous-3"
    rows[2] = row("previous-3", 0.004, 30.0 * SAME_COST * 1.01)
    assert judged(rows).algorithm == "previous-1"


def test_lower_rates_do_not_vote():
    rows = [row("previous-1", 0.3), row("previous-3", 0.004), row("uncompensated", 0.0, decimate=2)]
    result = judged(rows)
    assert result.algorithm == "previous-3"
    assert "uncompensated" not in result.text


def test_too_short():
    assert judged([row("previous-1", None)]).algorithm is None
    assert "too short" in judged([row("previous-1", None)]).text
    unjudged = judged([row("previous-1", 0.1)], resolution=None)
    assert unjudged.algorithm is None
    assert "too short to judge" in unjudged.text
    one = judged([row("previous-1", 0.3, windows=1), row("previous-3", 0.001, windows=1)])
    assert one.text.endswith("(one window only, so the spread is unknown)")


def test_a_log_shorter_than_a_window_names_none():
    """One of 3 s called an algorithm cheap that costs ten times as much as the others."""
    few = {"windows": 1}
    rows = [row("previous-1", 0.3, **few), row("previous-3", 0.001, **few)]
    for same in (rows, rows[1:], [*rows, row("uncompensated", 4.0, **few)]):
        answer = verdict(same, "quatfiter-4", 1e-3 / IN_DEG_H, 0.01 / IN_DEG_H, short=True)
        assert answer.algorithm is None and not answer.agree
        assert "too short to choose by" in answer.text
        assert ("previous-1 0.3 deg/h" in answer.text) == (len(same) > 1)
        assert answer.text.endswith("(one window only, so the spread is unknown)")


def test_against_a_truth():
    rows = [row("uncompensated", 16.0), row("previous-1", 0.3), row("previous-3", 0.0002)]
    result = judged(rows, None, reference="truth")
    assert result.algorithm == "previous-3"
    assert "sensor" not in result.text
    # a bias on all of them, evened out by one's own error by chance, is no merit
    rows = [row("uncompensated", 1553.0), row("previous-1", 1556.0), row("previous-3", 1557.0)]
    result = judged(rows, None, reference="truth")
    assert result.algorithm is None
    assert "even the closest drifts from it by 1553 deg/h" in result.text
    assert "the sensor's error (its bias, above all)" in result.text
    assert "No two of them differ by more than that" in result.text
    rows = [row("uncompensated", 90.0), row("previous-1", 1.2), row("previous-3", 1.0)]
    result = judged(rows, None, reference="truth")
    assert result.algorithm is None
    assert "Only larger differences show: uncompensated 90 deg/h" in result.text
    rows = [row("uncompensated", 0.005), row("previous-1", 0.001)]
    result = judged(rows, None, reference="truth")
    assert result.agree
    assert "any will do" in result.text
