"""How far the rate of quiet times may be from the bias."""

import numpy as np
import pytest

from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    GYRO,
    MOVING,
    RATE_DOUBT,
    REST,
    STEADY,
    WIDTH,
)
from sinstool.methods.attitude_smoother.model import SensorModel
from sinstool.methods.attitude_smoother.quiet_doubt import note_doubt

TURN = 0.02  # rad/s


def doubt_of(straight, bends):
    """Doubt of the rate, rad/s, of stretches of a straight way beside bends that looked like rest.

    Lengths in epochs; between any two something moves.
    """
    parts = [(long, 0.0) for long in straight] + [(long, TURN) for long in bends]
    rows = np.zeros((sum(long + 5 for long, _ in parts), WIDTH))
    rows[:, ACCEL + 2] = -9.8
    looked, at = np.zeros(len(rows), bool), 0
    random = np.random.default_rng(3)
    for long, rate in parts:
        looked[at : at + long] = True
        rows[at : at + long, REST] = STEADY if rate == 0.0 else MOVING
        rows[at : at + long, GYRO + 2] = rate
        at += long + 5
    rows[:, GYRO : GYRO + 3] += 1e-5 * random.standard_normal((len(rows), 3))
    note_doubt(rows, looked, SensorModel())
    steady = rows[:, REST] == STEADY
    return float(np.sqrt(rows[steady, RATE_DOUBT].max() / max(straight)))


@pytest.mark.parametrize("bends", [[250], [10] * 25, [3] * 80])
def test_a_bend_counts_by_its_length_however_many_pieces_it_looks_like(bends):
    assert doubt_of([300, 200, 400, 100], bends) < 1e-4


@pytest.mark.parametrize("bends", [[1500, 1500], [150] * 20])
def test_where_most_of_what_looked_like_rest_turns_nothing_shows_the_bias(bends):
    assert doubt_of([300, 200, 400, 100], bends) > 0.3 * TURN
