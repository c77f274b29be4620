import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sinstool.methods.hse.statistics import fit_sinusoid, scatter, validation_table
from tests.methods.hse.made_runs import ARCSEC
from tests.methods.hse.published_table1 import AFTER, AZIMUTH_DEG, BEFORE, POSITION

AZIMUTH = np.radians(AZIMUTH_DEG)


@example(np.pi, list(range(12)))  # differences either side of 180 deg
@example(0.0, list(range(12)))
@given(st.floats(0.0, 2.0 * np.pi), st.permutations(range(12)))
def test_table_1_of_the_paper_from_headings(zero, order):
    """Headings that the columns stand for give them back, wherever the stand's zero points."""
    order = np.array(order)
    before = ((AZIMUTH + zero + BEFORE * ARCSEC) % (2 * np.pi))[order]
    after = ((AZIMUTH + zero + AFTER * ARCSEC) % (2 * np.pi))[order]
    table = validation_table(AZIMUTH[order], before, after)
    np.testing.assert_allclose(table.before.values / ARCSEC, BEFORE[order], atol=2e-3)
    np.testing.assert_allclose(table.after.values / ARCSEC, AFTER[order], atol=4e-3)
    assert table.before.scatter.peak_to_peak / ARCSEC == pytest.approx(40.50, abs=1e-6)
    assert table.after.scatter.peak_to_peak / ARCSEC == pytest.approx(28.50, abs=1e-6)
    np.testing.assert_array_equal(table.position, POSITION[order])
    np.testing.assert_allclose(table.position_azimuth, AZIMUTH[::3], atol=1e-9)
    assert table.before.sinusoid.p == pytest.approx(fit_sinusoid(AZIMUTH, BEFORE).p, rel=1e-6)
    assert np.cos(table.before.mean - zero) == pytest.approx(1.0, abs=1e-9)
    within = scatter(AFTER, POSITION).within_std
    assert table.after.scatter.within_std / ARCSEC == pytest.approx(within, rel=1e-6)


def test_repeats_either_side_of_north_are_one_position():
    azimuth = np.array([-0.001, 0.001, 6.2825, 1.0, 1.001])
    table = validation_table(azimuth, azimuth + 2.0, azimuth + 2.0, ids=list("abcde"))
    np.testing.assert_array_equal(np.unique(table.position[:3]), [table.position[0]])
    assert table.ids == ("a", "b", "c", "d", "e")
    assert len(table.position_azimuth) == 2
    assert table.before.sinusoid is None
    assert table.before.scatter.rms == table.after.scatter.rms


def test_columns_must_match():
    with pytest.raises(ValueError, match="equal columns"):
        validation_table([0.0, 1.0], [0.0], [0.0, 1.0])
    with pytest.raises(ValueError, match="names"):
        validation_table([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], ids=["a"])
