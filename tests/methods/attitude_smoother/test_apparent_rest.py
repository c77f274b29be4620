"""Which quiet epochs count as rest before a filter has seen them."""

import numpy as np

from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    ACCEL_VARIANCE,
    COUNT,
    GYRO,
    GYRO_VARIANCE,
    WIDTH,
    Epochs,
)
from sinstool.methods.attitude_smoother.rest import with_rest

EPOCH_NS = 200_000_000


def epochs_of(*parts):
    """Of parts: how many epochs, rate about the vertical, specific force, scatter of the rate."""
    rows = np.zeros((sum(part[0] for part in parts), WIDTH))
    rows[:, COUNT] = 20.0
    rows[:, GYRO_VARIANCE : GYRO_VARIANCE + 3] = 1e-3**2
    rows[:, ACCEL_VARIANCE : ACCEL_VARIANCE + 3] = 1e-2**2
    random, at = np.random.default_rng(4), 0
    for count, rate, force, scatter in parts:
        part = slice(at, at + count)
        rows[part, GYRO + 2] = rate
        rows[part, ACCEL + 2] = -force
        rows[part, GYRO : GYRO + 3] += scatter * random.standard_normal((count, 3))
        at += count
    return Epochs(np.arange(len(rows) + 1) * EPOCH_NS, rows)


def test_a_banked_turn_in_which_nothing_shakes_is_no_rest():
    """Although it lasts longer than the rest: its specific force is that of no other time."""
    rest, turn = (100, 1e-4, 9.8, 1e-5), (200, 0.1, 12.0, 1e-5)
    moving = (150, 0.0, 9.8, 0.05)
    found = with_rest(epochs_of(rest, moving, turn, moving)).at_rest
    assert found[:100].all() and not found[100:].any()
