"""A latency that was only tried, as no attitude fits the fixes at their stamps."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets
from sinstool.methods.receiver_priors import LATENCY_S
from sinstool.pipelines.process.ins_gnss.start import without_trial
from tests.helpers.filter_logs import first_start_of
from tests.helpers.unseen_drives import GRADES, drive, record, write


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    data = record(drive(3, 60.0, 20.0), GRADES["tactical"], 3, sigma_v=0.05)
    log = write(tmp_path_factory.mktemp("tried") / "log.mcap", data)
    first = first_start_of(log, input={"gyro_kind": "mean-rate"})[0]
    moving = first.start.nav.copy()
    moving[3:6] = 20.0, 0.0, -5.0
    return replace(first, start=replace(first.start, nav=moving))


def estimated(start, tried, estimate, sigma, status):
    """The start at fixes of a latency that was tried, and an estimate about it."""
    covariance = np.diag([sigma**2, 0.01, 0.01, 0.01])
    zero = np.zeros(3)
    shown = ReceiverOffsets(estimate, zero, covariance, zero, zero + 0.1, np.zeros((3, 4, 4)))
    settings = replace(start.settings, gnss_latency=tried)
    return replace(start, settings=settings, offsets=shown, latency_status=status)


def sigma_of(start):
    return np.sqrt(start.offsets_error[0, 0])


def test_an_unseen_latency_is_no_less_certain_than_its_prior(begun):
    """A balloon whose start was found at a rough latency was uncertain by 1.3 s."""
    tried = estimated(begun, -1.25, 0.04, 0.15, "not observable")
    assert sigma_of(tried) > 1.2
    used = without_trial(tried)
    assert used.settings.gnss_latency == 0.04
    assert sigma_of(used) == pytest.approx(0.15)
    assert sigma_of(used) <= LATENCY_S
    # The first position was that of a fix at another time
    grown = used.start.covariance_position_n - begun.start.covariance_position_n
    moved = 1.29 * np.array([20.0, 0.0, -5.0])
    np.testing.assert_allclose(grown, np.outer(moved, moved), atol=1e-6)


@pytest.mark.parametrize(
    ("tried", "status"),
    [(0.15, "found"), (0.15, "not settled"), (0.15, "given"), (0.0, "not observable")],
)
def test_other_latencies_stay(begun, tried, status):
    start = estimated(begun, tried, 0.04, 0.02, status)
    assert without_trial(start) is start
