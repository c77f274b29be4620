"""A receiver that takes a wrong ambiguity for fixed is off by a metre or two and says 2 cm."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    T0,
    drive,
    moved,
    multicopter,
    record,
    with_outliers,
    without_fixes,
    without_samples,
    write,
)

SIGMA = 0.02


def recorded(seed, truth, spans, sigma_v=None, rate=5.0, scatter=0.03):
    """A log whose fixes are wrong in some spans, each by another metre or two."""
    data = record(truth, GRADES["industrial"], seed, gnss_rate=rate, sigma=SIGMA, sigma_v=sigma_v)
    random, fixes = np.random.default_rng([seed, 21]), data.fixes
    off = np.zeros((len(fixes.seconds), 3))
    for begin, end in spans:
        inside = (fixes.seconds >= begin) & (fixes.seconds < end)
        way = random.standard_normal(3) * [1.0, 1.0, 1.5]
        off[inside] = way * random.uniform(1.0, 2.5) / np.linalg.norm(way)
        off[inside] += scatter * random.standard_normal((np.count_nonzero(inside), 3))
    place = moved(fixes.latitude, fixes.longitude, fixes.height, off)
    latitude, longitude, height = place
    return replace(
        data, fixes=replace(fixes, latitude=latitude, longitude=longitude, height=height)
    )


def worst(data, solution):
    """Largest horizontal and vertical errors over their sigmas, after the start."""
    rows = solution.rows((solution.time_ns - T0) * 1e-9 > 10.0)
    seconds = (rows.time_ns - T0) * 1e-9
    error = data.truth.errors_of(seconds, *rows.position.T, rows.velocity_n, np.eye(3)[None])
    variance = np.einsum("nii->ni", rows.covariance_position_n)
    ratio = np.abs(error[:, :3]) / np.sqrt(variance)
    return float(ratio.max()), float(np.sqrt(np.mean(ratio**2)))


CASES = {
    "velocities": (drive, [(60, 80), (110, 118), (160, 195)], 0.05),
    "positions": (drive, [(60, 80), (110, 118), (160, 195)], None),
    "multicopter": (multicopter, [(40, 48), (90, 130)], 0.05),
    "to the end": (drive, [(150, 220)], None),
    "from the start": (drive, [(0, 90)], 0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_fixes_that_are_off_for_a_while(tmp_path, case, smooth):
    """They are told, and the solution is no further off than its sigmas say."""
    make, spans, sigma_v = CASES[case]
    for seed in range(2):
        truth = make(seed, 220.0, rest=20.0) if make is drive else make(seed, 220.0)
        data = recorded(seed, truth, spans, sigma_v)
        log = write(tmp_path / "log.mcap", data)
        result, solution = run(
            log, gnss={"lever_arm": tuple(LEVER.tolist())}, filter={"smooth": smooth}
        )
        most, usual = worst(data, solution)
        found = [f for f in result["findings"] if f["kind"] == "false-fixes"]
        assert len(found) == len(spans)
        for finding, (begin, end) in zip(found, spans, strict=True):
            seconds = [(int(finding[name]) - T0) * 1e-9 for name in ("start_ns", "end_ns")]
            assert seconds == pytest.approx([begin, end], abs=0.41)
        assert most < 5.0 and usual < 1.7


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("case", ["velocities", "multicopter", "to the end"])
def test_fixes_that_scatter_and_are_off_for_a_while(tmp_path, case, smooth):
    """Averaged as white noise they would make a position of centimetres, metres off."""
    make, spans, sigma_v = CASES[case]
    for seed in range(2):
        truth = make(seed, 220.0, rest=20.0) if make is drive else make(seed, 220.0)
        data = recorded(seed, truth, spans, sigma_v, scatter=0.5)
        log = write(tmp_path / "log.mcap", data)
        result, solution = run(
            log, gnss={"lever_arm": tuple(LEVER.tolist())}, filter={"smooth": smooth}
        )
        most, usual = worst(data, solution)
        assert [f for f in result["findings"] if f["kind"] == "false-fixes"]
        assert most < 6.0 and usual < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_outliers_and_lost_fixes_do_not_part_a_stretch_from_those_beside_it(tmp_path, rate):
    """Between two of them the longer part would count as right."""
    for seed in range(2):
        data = recorded(seed, drive(seed, 220.0, rest=20.0), [(100, 120), (150, 170)], rate=rate)
        # In the good fixes shortly before each stretch, and in the stretch
        data = without_fixes(data, [(t - 0.1, t + 0.1) for t in (96.0, 144.0, 165.0)])
        far = np.isin(np.round(data.fixes.seconds, 3), [94.0, 122.0, 146.0, 162.0])
        latitude = data.fixes.latitude + np.where(far, 60.0 / 6.4e6, 0.0)
        data = replace(data, fixes=replace(data.fixes, latitude=latitude))
        assert np.count_nonzero(far) == 4
        result, _ = run(
            write(tmp_path / "log.mcap", data), gnss={"lever_arm": tuple(LEVER.tolist())}
        )
        found = [f for f in result["findings"] if f["kind"] == "false-fixes"]
        seconds = [[(int(f[name]) - T0) * 1e-9 for name in ("start_ns", "end_ns")] for f in found]
        expected = np.array([(100.0, 120.0), (150.0, 170.0)])
        assert np.array(seconds) == pytest.approx(expected, abs=0.6)


@pytest.mark.slow
def test_good_fixes_stay_as_the_receiver_says(tmp_path):
    """Whatever the antenna's arm, which the filter does not know, its outages and outliers."""
    for seed in range(2):
        data = recorded(seed, drive(seed, 220.0, rest=20.0), [], 0.05)
        data = without_fixes(with_outliers(data, seed), [(70.0, 82.0), (120.0, 121.0)])
        result, _ = run(write(tmp_path / "log.mcap", data))
        assert not [f for f in result["findings"] if f["kind"] == "false-fixes"]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "truth"), [(3, drive), (8, drive), (2, multicopter)])
def test_a_filter_that_restarts_does_not_blame_the_fixes(tmp_path, seed, truth):
    """Its errors after a gap of the IMU are larger than any of a receiver."""
    data = record(truth(seed, 360.0), GRADES["industrial"], seed)
    data = without_samples(data, 200.0, 60.0)
    result, _ = run(write(tmp_path / "log.mcap", data), gnss={"lever_arm": tuple(LEVER.tolist())})
    assert not [f for f in result["findings"] if f["kind"] == "false-fixes"]


@pytest.mark.slow
def test_fixes_that_are_off_after_a_gap_of_the_imu_are_found(tmp_path):
    data = recorded(3, drive(3, 420.0), [(330.0, 360.0)])
    data = without_samples(data, 200.0, 30.0)
    result, _ = run(write(tmp_path / "log.mcap", data), gnss={"lever_arm": tuple(LEVER.tolist())})
    (found,) = [f for f in result["findings"] if f["kind"] == "false-fixes"]
    assert int(found["start_ns"]) == pytest.approx(T0 + 330 * 10**9, abs=10**9)
    assert int(found["end_ns"]) == pytest.approx(T0 + 360 * 10**9, abs=10**9)
