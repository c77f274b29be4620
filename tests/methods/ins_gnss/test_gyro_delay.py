"""Gyros that are stamped later than accelerometers: their errors, and what an estimate says."""

from dataclasses import dataclass, fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.ins_gnss.gyro_delay import GyroDelay, by_late_gyros, in_time
from sinstool.methods.ins_gnss.results import UpdateColumns
from sinstool.methods.strapdown.velocity import Increments

STEP = 0.01
NAMES = [field.name for field in fields(UpdateColumns)]


@dataclass
class Motion:
    """A body that turns about all axes while forces act on it, in a frame that does not turn."""

    seconds: np.ndarray

    def attitude(self, late=0.0):
        t = self.seconds - late
        angles = [0.3 * np.sin(0.9 * t), 0.2 * np.cos(0.7 * t), 0.5 * t + 0.3 * np.sin(0.4 * t)]
        return Rotation.from_euler("ZYX", np.stack(angles[::-1], axis=1))

    @property
    def force_b(self):
        t = self.seconds
        return np.stack([np.sin(0.5 * t), 2.0 * np.cos(0.3 * t), -9.8 + np.sin(t)], axis=1)

    def updates(self):
        """At the ends of the intervals that `seconds` are the middles of."""
        ends = Motion(self.seconds + 0.5 * STEP)
        before = Motion(self.seconds - 0.5 * STEP)
        q = ends.attitude()
        rate = (before.attitude().inv() * q).as_rotvec() / STEP
        columns = dict.fromkeys(NAMES)
        columns |= {
            "time_ns": np.round(ends.seconds * 1e9).astype(np.int64),
            "q_nb": np.roll(q.as_quat(), 1, axis=1),
            "omega_ib_b": rate,
            "specific_force_b": self.force_b,
        }
        return UpdateColumns(**columns)


def whole(grown, rows_s, end_s):
    """Position and velocity at the end, by errors that come up in spans and then go on."""
    begins = np.concatenate([rows_s, [end_s]])
    return (grown[:, :3] + (end_s - begins)[:, None] * grown[:, 3:]).sum(axis=0), grown[:, 3:].sum(
        axis=0
    )


def test_errors_are_those_of_a_navigation_with_late_gyros():
    motion = Motion(np.arange(0.0, 20.0, STEP) + 0.5 * STEP)
    late = 1e-3
    off = motion.attitude(late).apply(motion.force_b) - motion.attitude().apply(motion.force_b)
    velocity = np.cumsum(off, axis=0) * STEP
    position = np.cumsum(velocity, axis=0) * STEP
    rows_s = np.arange(0.7, 20.0, 1.3)
    rows_ns = np.round(rows_s * 1e9).astype(np.int64)
    turned, grown = by_late_gyros(
        motion.updates(), np.full(len(motion.seconds), STEP), rows_ns, rows_ns
    )
    at_end, speed = whole(grown, rows_s, 20.0)
    np.testing.assert_allclose(late * speed, velocity[-1], atol=0.01 * np.abs(velocity).max())
    np.testing.assert_allclose(late * at_end, position[-1], atol=0.01 * np.abs(position).max())
    # psi takes the attitude of late gyros to the true one
    there = Motion(rows_s)
    psi = (there.attitude() * there.attitude(late).inv()).as_rotvec()
    np.testing.assert_allclose(late * turned, psi, atol=0.01 * np.abs(psi).max())


def test_spans_may_be_cut_anywhere():
    motion = Motion(np.arange(0.0, 8.0, STEP) + 0.5 * STEP)
    interval = np.full(len(motion.seconds), STEP)
    ends = [np.array([]), np.array([3.0]), np.array([0.5, 0.52, 4.44, 8.0])]
    results = []
    for rows in ends:
        ns = np.round(rows * 1e9).astype(np.int64)
        _, grown = by_late_gyros(motion.updates(), interval, ns, ns)
        results.append(np.concatenate(whole(grown, rows, 8.0)))
    np.testing.assert_allclose(results[1], results[0], atol=1e-9)
    np.testing.assert_allclose(results[2], results[0], atol=1e-9)


@pytest.mark.parametrize("delay", [0.04, -0.13, 0.0])
def test_gyros_brought_in_time_turn_when_the_body_does(delay):
    seconds = np.arange(0.0, 5.0, STEP)
    ends = seconds + STEP

    def turned(t):  # about axes that stay, so that rotations add up
        return np.stack([np.sin(t), 0.0 * t, np.cos(2.0 * t)], axis=1)

    made = Increments(
        np.arange(len(ends)),
        np.round(ends * 1e9).astype(np.int64),
        np.full(len(ends), STEP),
        turned(ends - delay) - turned(seconds - delay),
        np.zeros((len(ends), 3)),
        followed_rate=turned(ends - delay),
    )
    right = in_time(made, delay)
    inside = (seconds > abs(delay)) & (ends < 5.0 - abs(delay))
    np.testing.assert_allclose(
        right.rotation_vector[inside], (turned(ends) - turned(seconds))[inside], atol=1e-5
    )
    np.testing.assert_allclose(right.followed_rate[inside], turned(ends)[inside], atol=1e-3)
    assert right.velocity_increment is made.velocity_increment


@pytest.mark.parametrize(
    ("delay", "sigma", "shown"),
    [(0.1, 0.01, True), (-0.1, 0.01, True), (0.1, 0.03, False), (0.015, 0.001, False)],
)
def test_a_delay_is_shown_if_it_is_large_and_no_chance(delay, sigma, shown):
    turns = np.stack([np.linspace(0.0, 1.0, 101), np.linspace(0.0, 40.0, 101)], axis=1)
    made = GyroDelay.of(delay, sigma, turns)
    assert made.shown == shown
    assert made.turn == pytest.approx(0.95 * abs(delay))
    assert made.sigmas == pytest.approx(38.0 * abs(delay))
