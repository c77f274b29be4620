"""Figures of a comparison of algorithms on a log of hand-held motion."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.pipelines.compare_coning.log import compare_log
from sinstool.report.figures.coning import RANGE, figures
from tests.helpers.imulogs import even_times, handheld, imu_log

ALGORITHMS = ("uncompensated", "previous-1", "previous-3", "quatfiter-4", "picard-4")


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    path = tmp_path_factory.mktemp("coning") / "log.mcap"
    gyro, accel, _ = handheld(3000)
    imu_log(path, even_times(3000), gyro, accel)
    chosen = {"comparison": {"algorithms": ALGORITHMS, "decimate": (1, 2), "window": 2.0}}
    result = compare_log(path, build(ProcessConfig, chosen, check=False))
    return result, {one.key: one for one in figures(result)}


def test_divergence_ends_where_the_reference_can_resolve_no_more(compared):
    result, shown = compared
    figure = shown["divergence"]
    low, high = figure.y_range
    most = max(float(np.nanmax(one.y)) for one in figure.series)
    assert high == pytest.approx(2.0 * most) and low >= RANGE * most
    assert all(np.nanmax(one.y) > low for one in figure.series)
    # The reference itself has no divergence, and is named below
    names = [one.name for one in figure.series]
    assert result.comparison.reference not in names
    assert result.comparison.reference in figure.notes[1]
    # From the largest to the smallest, as they lie beside the figure
    ends = [one.y[-1] for one in figure.series]
    assert ends == sorted(ends, reverse=True) and names[0] == "uncompensated"


def test_bars_have_their_uncertainty(compared):
    result, shown = compared
    drifts = [row.drift_dph for row in result.comparison.rows if row.candidate.decimate == 1]
    for k, one in enumerate(shown["drift"].series):
        np.testing.assert_array_equal(one.y, [d.mean[k] for d in drifts])
        np.testing.assert_array_equal(one.error, [d.confidence[k] for d in drifts])


def test_decimation_shows_no_rounding(compared):
    sizes = np.concatenate([one.y for one in compared[1]["decimation"].series])
    assert sizes.min() > RANGE * sizes.max()
