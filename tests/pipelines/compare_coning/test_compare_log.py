"""From a file to a comparison: stretches, kinds, truth with holes, real logs."""

import json

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import DataError
from sinstool.io.readers import open_log
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H
from sinstool.pipelines.compare_coning.log import compare_log, gyro_segments, truth_at
from sinstool.pipelines.compare_coning.runs import Segment
from sinstool.pipelines.compare_coning.summary import summarise
from sinstool.report.figures.coning import figures
from sinstool.survey.source import prepare
from tests.helpers.imulogs import even_times, handheld, imu_log, resting
from tests.helpers.logs import real

FEW = {"algorithms": ("uncompensated", "previous-1", "previous-3"), "decimate": (1,)}
NATIVE = {"decimate": (1,)}


def config(comparison=None, coning=None, **options):
    groups = {"input": options, "comparison": comparison or {}, "coning": coning or {}}
    return build(ProcessConfig, groups, check=False)


def text_of(result, kind):
    """Text of the finding of that kind, of which there is one."""
    (text,) = [f.text for f in result.findings if f.kind == kind]
    return text


def stretches(path, **options):
    chosen = config(**options)
    with open_log(path) as log:
        return gyro_segments(prepare(log, chosen), chosen)


@pytest.fixture
def moving(tmp_path):
    gyro, accel, _ = handheld(2000)
    return gyro, accel, tmp_path / "log.mcap"


def test_whole_record_in_body_axes(moving):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro, accel)
    result, interval = stretches(path)
    assert interval == pytest.approx(0.005)
    assert len(result) == 1
    assert np.array_equal(result[0].time_ns, even_times(2000))
    # forward, left, up to forward, right, down
    np.testing.assert_array_equal(result[0].gyro, gyro * [1.0, -1.0, -1.0])


def test_gaps_and_lost_samples_cut(moving):
    gyro, accel, path = moving
    times = even_times(2000)
    times[700:] += 50_000_000
    gyro[1500:1510] = np.nan
    imu_log(path, times, gyro, accel)
    actual, _ = stretches(path)
    assert [len(s) for s in actual] == [700, 800, 490]
    assert actual[2].time_ns[0] == times[1510]
    result = compare_log(path, config(FEW))
    assert result.comparison.segments == 3
    assert result.checks.gaps == 2
    assert result.checks.not_finite == 10
    assert "longest stretch only (4 s)" in text_of(result, "longest-stretch")


def test_increments_become_mean_rates(moving):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro * 0.005, accel * 0.005)
    result, _ = stretches(path, gyro_kind="increment")
    np.testing.assert_allclose(
        result[0].gyro[1:], gyro[1 : len(result[0])] * [1.0, -1.0, -1.0], rtol=1e-9
    )
    compared = compare_log(path, config(FEW, gyro_kind="increment"))
    assert compared.comparison.kind == "mean-rate"
    # What is printed is what the log has
    assert summarise(compared).meta.gyro_kind == "increment"


def test_given_rate_replaces_intervals(moving):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro, accel)
    result, interval = stretches(path, imu_rate=210.0)
    assert interval == pytest.approx(1 / 210.0)
    np.testing.assert_allclose(np.diff(result[0].time_ns), 1e9 / 210.0, atol=1.0)


def test_given_rate_is_the_interval_of_increments_too(moving):
    """Four samples at a time, a millisecond apart, as a busy computer stamps them."""
    gyro, accel, path = moving
    burst = even_times(2000)[3::4].repeat(4) + np.tile([-3, -2, -1, 0], 500) * 1_000_000
    imu_log(path, burst, gyro * 0.005, accel * 0.005)
    result, _ = stretches(path, gyro_kind="increment", imu_rate=200.0)
    np.testing.assert_allclose(result[0].gyro, gyro * [1.0, -1.0, -1.0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rate", [0.2, 0.5])
def test_samples_too_far_apart_for_the_band_of_the_bounds(moving, rate):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro / 200.0, accel)
    compared = compare_log(path, config(FEW, imu_rate=rate))
    assert compared.bounds is None
    assert compared.comparison.kind == "rate"


def test_truth_with_a_hole_says_nothing_there():
    times = 10_000_000 * np.arange(100)
    hole = np.concatenate([times[:40], times[60:]])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(hole), 1))
    native = Segment(2_500_000 * np.arange(-10, 410), np.zeros((420, 3)))
    result = truth_at(hole, q, native)
    at = native.time_ns[result.sample]
    assert at.min() == 0
    assert at.max() == times[-1]
    assert not np.any((at > times[39]) & (at < times[60]))
    assert {times[39], times[60]} <= set(at.tolist())
    assert len(at) == 39 * 4 + 1 + 39 * 4 + 1


def test_truth_in_another_clock_is_refused(moving, tmp_path):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro, accel)
    other = tmp_path / "truth.csv"
    other.write_text("time_s,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n2,1,0,0,0\n")
    with pytest.raises(DataError, match="no two instants within the samples of /imu"):
        compare_log(path, config({**FEW, "truth": str(other)}))


def test_bands_have_to_be_within_the_log(moving):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro, accel)
    for bands in ({"passband": 100.0}, {"stopband": 100.0}, {"passband": 40.0, "stopband": 30.0}):
        with pytest.raises(DataError, match="band"):
            compare_log(path, config(FEW, bands))
    within = compare_log(path, config(FEW, {"passband": 20.0, "stopband": 40.0}))
    assert "no-stopband" not in {f.kind for f in within.findings}


def test_tuned_options_reach_the_candidates(moving):
    gyro, accel, path = moving
    imu_log(path, even_times(2000), gyro, accel)
    both = {"algorithms": ("singular-perturbation", "gyro-tuned"), "decimate": (1,)}
    bands = {"passband": 20.0, "stopband": 60.0}
    paper = compare_log(path, config(both, {**bands, "sp_preset": "paper"}))
    best = compare_log(path, config(both, {**bands, "sp_preset": "best"}))
    drift = [c.comparison.rows[0].drift_dph.norm_rms for c in (paper, best)]
    assert abs(drift[0] - drift[1]) > 1e-3
    wider = compare_log(path, config(both, {"passband": 20.0, "stopband": 80.0}))
    tuned = [c.comparison.rows[1].drift_dph.norm_rms for c in (best, wider)]
    assert tuned[0] != tuned[1]


def test_still_log_says_so(tmp_path):
    gyro, accel = resting(6000)
    path = imu_log(tmp_path / "still.mcap", even_times(6000), gyro, accel)
    result = compare_log(path, config(NATIVE))
    assert result.comparison.verdict.agree
    assert result.comparison.verdict.text.endswith(
        "holds only for rest; if it is vibration, it is sampled too slowly for any algorithm"
    )
    moving, accel, _ = handheld(6000)
    path = imu_log(tmp_path / "moving.mcap", even_times(6000), moving, accel)
    answer = compare_log(path, config(NATIVE)).comparison.verdict
    assert "noise" not in answer.text
    assert "uncompensated " in answer.text


def test_two_seconds_and_less(tmp_path):
    gyro, accel, _ = handheld(400)
    path = imu_log(tmp_path / "two.mcap", even_times(400), gyro, accel)
    result = compare_log(path, config(NATIVE))
    assert result.comparison.verdict.text.endswith("(one window only, so the spread is unknown)")
    assert "less than one window of 10 s" in text_of(result, "short-log")
    path = imu_log(tmp_path / "less.mcap", even_times(60), gyro[:60], accel[:60])
    result = compare_log(path, config())
    assert result.spectrum is None
    assert "no predicted drift" in text_of(result, "no-spectrum")
    json.dumps(summarise(result).to_json())
    assert [f.key for f in figures(result)] == ["divergence", "drift", "decimation"]
    path = imu_log(tmp_path / "none.mcap", even_times(8), gyro[:8], accel[:8])
    with pytest.raises(DataError, match="long enough to compare"):
        compare_log(path, config())


@pytest.mark.parametrize(
    ("path", "apart", "resolution"),
    [
        ("broad/broad_06_undisturbed_fast_rotation_A.mcap", {"uncompensated", "optimal-4"}, 0.065),
        # of which only what manoeuvres do to long updates is beyond what the log can tell
        ("euroc/euroc_V1_01_easy.mcap", {"optimal-4"}, 0.031),
    ],
)
def test_resolution_of_real_logs_is_not_overstated(path, apart, resolution):
    result = compare_log(real(path), config(NATIVE))
    c = result.comparison
    assert c.reference_resolution * IN_DEG_H == pytest.approx(resolution, rel=0.1)
    assert c.verdict.algorithm is None
    limit = c.verdict.limit_dph
    assert limit == pytest.approx(2 * resolution, rel=0.1)
    over = {r.candidate.name for r in c.rows if r.drift_dph.slope_rms > limit}
    assert over == apart
    answer = c.verdict.text.partition("Only larger differences show: ")[2].partition(" deg/h.")[0]
    assert {part.split(" ")[0] for part in answer.split(", ")} == apart
    assert "previous-3, the default, is among them" in c.verdict.text
    # nothing above half the rate is spoken of
    assert result.spectrum.frequency[-1] <= 0.5 * c.rate_hz * (1 + 1e-9)
    assert "above half its sampling rate" in text_of(result, "sampling-limit")
    unresolved = {r.candidate.name for r in c.rows if not r.resolved}
    assert {"previous-3", "quatfiter-4", "picard-4", "lookahead-12"} <= unresolved


def test_truth_of_a_real_log_does_not_rank_by_its_bias():
    path = real("broad/broad_06_undisturbed_fast_rotation_A.mcap")
    truth = real("broad/broad_06_undisturbed_fast_rotation_A.ref.csv")
    result = compare_log(path, config({**FEW, "truth": str(truth)}))
    assert result.comparison.verdict.algorithm is None
    assert "The truth cannot tell which algorithm" in result.comparison.verdict.text
    assert "bias" in result.comparison.verdict.text
