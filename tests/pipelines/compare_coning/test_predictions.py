"""The spectrum's prediction against runs over broadband vibration with exact truth."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_spectrum
from sinstool.pipelines.compare_coning.compare import Settings, compare
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H
from sinstool.pipelines.compare_coning.runs import Attitudes, Candidate, Segment
from sinstool.pipelines.compare_coning.summary import predict
from sinstool.simulation.motions import broadband, sample
from sinstool.simulation.truth import sample_times
from tests.helpers.coning_response import coning_gain, coning_rate, coning_samples

STEP = 0.0025
PER_SAMPLE = ("uncompensated", "previous-1", "previous-2", "previous-3", "lookahead-12")
OTHERS = ("optimal-2", "optimal-4", "quatfiter-4", "singular-perturbation")


@pytest.fixture(scope="module")
def motion():
    # 20 to 150 Hz, 64 s
    return sample(broadband(2e-4, seed=1), sample_times(400.0, 64.0))


@pytest.fixture(scope="module", params=["rate", "mean-rate"])
def result(request, motion):
    kind = request.param
    gyro = motion.gyro_rate if kind == "rate" else motion.gyro_mean_rate
    n = len(gyro)
    compared = compare(
        [Segment(motion.time_ns, gyro)],
        kind,
        STEP,
        Settings(PER_SAMPLE + OTHERS, decimate=(1, 2), window_s=16.0),
        [Attitudes(np.arange(n), motion.q_nb, 0.0, n)],
    )
    return compared, coning_spectrum(gyro, STEP, kind)


def test_per_sample_algorithms_drift_as_predicted(result):
    compared, spectrum = result
    seen = 0
    for row in compared.rows:
        if row.candidate.decimate > 1 or row.candidate.name not in PER_SAMPLE:
            continue
        prediction = predict(row.candidate, spectrum, None, None)
        assert prediction.pred_exception == ""
        assert abs(prediction.pred_dph[2]) > 0.01
        # the body moves by hundredths of a degree: its axes are those of the reference
        assert row.drift_dph.mean[2] == pytest.approx(prediction.pred_dph[2], rel=0.03)
        assert np.abs(prediction.pred_dph[:2]).max() < 1e-4 * abs(prediction.pred_dph[2])
        seen += 1
    assert seen == len(PER_SAMPLE)


def test_exceptions_are_named_and_are_exceptions(result):
    compared, spectrum = result
    apart = {}
    for row in compared.rows:
        prediction = predict(row.candidate, spectrum, None, None)
        expected = row.candidate.decimate > 1 or row.candidate.name in OTHERS
        assert bool(prediction.pred_exception) == expected, row.candidate.label
        apart[row.candidate.label] = row.drift_dph.mean[2] / prediction.pred_dph[2] - 1.0
    # 130 Hz and 30 Hz are an update rate of optimal-4 apart
    assert abs(apart["optimal-4"]) > 0.015
    assert abs(apart["previous-3"]) < 0.01


@pytest.mark.parametrize("m", [2, 4])
def test_summed_increments_drift_as_predicted(motion, m):
    # sums of increments are what a slower integrating gyro gives: only lines that fold differ
    n = len(motion.time_ns)
    compared = compare(
        [Segment(motion.time_ns, motion.gyro_mean_rate)],
        "mean-rate",
        STEP,
        Settings(("uncompensated", "previous-1"), decimate=(1, m), window_s=16.0),
        [Attitudes(np.arange(n), motion.q_nb, 0.0, n)],
    )
    spectrum = coning_spectrum(motion.gyro_mean_rate, STEP, "mean-rate")
    rows = [r for r in compared.rows if r.candidate.decimate == m]
    assert len(rows) == 2
    for row in rows:
        prediction = predict(row.candidate, spectrum, None, None)
        assert row.drift_dph.mean[2] == pytest.approx(prediction.pred_dph[2], rel=0.03)
        assert "decimated" in prediction.pred_exception


def test_passband_and_stopband_split_one_line():
    gyro = coning_samples(0.01, 60.0, STEP, 16000, "mean-rate")
    spectrum = coning_spectrum(gyro, STEP, "mean-rate")
    candidate = Candidate("previous-1", algorithm("previous-1"))
    rate = coning_rate(0.01, 60.0) * IN_DEG_H
    gain = coning_gain(candidate.algorithm, 60.0, STEP)
    motion = predict(candidate, spectrum, 80.0, 100.0)
    assert motion.pred_dph[2] == pytest.approx((gain - 1.0) * rate, rel=5e-3)
    assert abs(motion.pseudo_dph[2]) < 1e-3 * rate
    noise = predict(candidate, spectrum, 20.0, 40.0)
    assert noise.pred_dph[2] == pytest.approx(gain * rate, rel=2e-3)
    assert noise.pseudo_dph[2] == pytest.approx(gain * rate, rel=2e-3)
    assert predict(candidate, spectrum, None, None).pseudo_dph is None
    # what candidates part by does not ask what is motion
    other = Candidate("uncompensated", algorithm("uncompensated"))
    apart = [
        predict(other, spectrum, p, None).pred_dph - predict(candidate, spectrum, p, None).pred_dph
        for p in (None, 20.0, 80.0)
    ]
    np.testing.assert_allclose(apart[1], apart[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(apart[2], apart[0], rtol=1e-9, atol=1e-9)


def test_a_slower_log_is_predicted_at_its_rate():
    # 60 Hz of a log at 400 Hz, summed by 4: an increment of 10 ms
    gyro = coning_samples(0.01, 30.0, STEP, 16000, "mean-rate")
    spectrum = coning_spectrum(gyro, STEP, "mean-rate")
    native = Candidate("previous-1", algorithm("previous-1"))
    slow = replace(native, decimate=4, input="sums")
    rate = coning_rate(0.01, 30.0) * IN_DEG_H
    for candidate, step in ((native, STEP), (slow, 4 * STEP)):
        gain = coning_gain(candidate.algorithm, 30.0, step)
        expected = (gain - 1.0) * rate
        assert predict(candidate, spectrum, None, None).pred_dph[2] == pytest.approx(
            expected, rel=5e-3, abs=1e-3 * rate
        )
