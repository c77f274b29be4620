"""Slopes of what the IMU shows, as velocities that are derived from positions have them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core.earth import displaced
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.derived_rates import slopes
from sinstool.methods.alignment.inflight_types import AlignmentSettings
from sinstool.methods.alignment.measurements import gnss_fixes
from sinstool.methods.alignment.preparation import Stretch
from sinstool.methods.alignment.segments import candidates
from sinstool.methods.ins_gnss.fix_velocity import with_velocities
from sinstool.simulation.gnss import Receiver, gnss_samples
from tests.helpers.filter_logs import first_start_of
from tests.helpers.gnss import epochs, straight
from tests.helpers.unseen_drives import GRADES, LEVER, T0, multicopter, record, write
from tests.methods.alignment.launches import PERFECT, antenna_truth, exact


@given(
    st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3),
    st.floats(0.5, 5.0),
    st.integers(0, 2**32 - 1),
)
def test_the_slope_of_a_parabola_is_exact(coefficients, half, seed):
    t = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.05, 1200))
    at = np.linspace(t[0], t[-1], 40)
    a, b, c = coefficients
    found, whole = slopes(t, (a + b * t + c * t**2)[:, None], at, np.full(40, half))
    inside = (at - half >= t[0]) & (at + half <= t[-1])
    assert (whole == inside).all()
    np.testing.assert_allclose(found[whole, 0], (b + 2.0 * c * at)[whole], rtol=1e-9, atol=1e-7)
    assert (found[~whole] == 0.0).all()


def test_too_few_rows_show_no_slope():
    found, whole = slopes(np.array([0.0, 1.0]), np.ones((2, 1)), np.array([0.5]), np.array([0.4]))
    assert not whole.any() and found.shape == (1, 1)
    assert not slopes(np.zeros(0), np.ones((0, 3)), np.array([0.5]), np.array([0.4]))[1].any()


@pytest.mark.parametrize("every_s", [1.0, 0.2, 0.05])
def test_a_bend_adds_the_same_to_slopes_of_fixes_and_of_the_imu(every_s):
    time_ns = np.arange(0, 40_000_000_000, round(every_s * 1e9))
    north = 0.1 * (time_ns * 1e-9 - 20.0) ** 3
    fixes = straight(time_ns)
    latitude, _ = displaced(fixes.latitude, fixes.longitude, fixes.height, north, 0.0)
    made = with_velocities(replace(fixes, latitude=latitude), 0.5)
    grid, at = np.arange(0.0, 40.0, 0.02), made.time_ns * 1e-9
    same, whole = slopes(grid, (0.1 * (grid - 20.0) ** 3)[:, None], at, made.derived_s)
    bend = np.abs(made.velocity_n[:, 0] - 0.3 * (at - 20.0) ** 2)[whole]
    off = np.abs(made.velocity_n[:, 0] - same[:, 0])[whole]
    assert whole.sum() > 0.5 * len(at) and bend.min() > 0.05
    assert (off < 0.05 * bend).all()


@pytest.mark.parametrize("begin_s", [20, 45])
def test_velocities_of_times_before_the_imu_are_left_out(begin_s):
    """How the vehicle moved then does not show: starts in motion were twice as far off."""
    receiver = Receiver(errors=PERFECT)
    flight, imu, _ = exact(receiver)
    seen = with_velocities(epochs(gnss_samples(flight, receiver, 1, antenna_truth(receiver))), 0.02)
    fixes, _ = gnss_fixes(seen, 0, int(imu.time_ns[-1]), 0.0)
    late = imu.rows(slice(int(np.searchsorted(imu.time_ns, begin_s * SECOND)), None))
    made = candidates(Stretch(late, ""), fixes, AlignmentSettings(gate="off"), begin_s * SECOND, [])
    used = np.isin(fixes.time_ns, made[0].fixes.time_ns)
    covered = fixes.time_ns - fixes.derived_s * SECOND >= late.time_ns[0]
    assert used.any() and not used[~covered].any()
    assert (covered & (fixes.time_ns < late.time_ns[0] + 2 * SECOND) & ~used).sum() <= 1


@pytest.mark.parametrize("seed", [40, 44])
def test_an_antenna_that_swings_is_no_inconsistency(tmp_path, seed):
    """Squared residuals were eight times too large, and a right lever arm was denied."""
    truth = multicopter(seed, 100.0)
    log = write(tmp_path / "log.mcap", record(truth, GRADES["tactical"], seed, sigma=0.02))
    start, _ = first_start_of(
        log,
        navigation={"mode": "ins-gnss"},
        input={"gyro_kind": "mean-rate"},
        gnss={"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0},
    )
    assert not [text for text in start.attitude_warnings if "inconsistent" in text]
    row = int(np.argmin(np.abs(truth.seconds - (start.time_ns - T0) / SECOND)))
    given_n = Rotation.from_quat(start.start.nav[6:10], scalar_first=True)
    off = (given_n * Rotation.from_matrix(truth.c_nb[row]).inv()).as_rotvec()
    assert (np.abs(off) < 3.0 * np.sqrt(np.diag(start.start.covariance_attitude_n))).all()
    assert np.rad2deg(np.abs(off).max()) < 2.0
