"""Coefficients in SI units, one figure for three axes, and what a filter makes of them."""

from __future__ import annotations

import numpy as np
import pytest

from sinstool.methods.allan.coefficients import (
    MANOEUVRE,
    MARKOV_OF_FLICKER,
    Coefficient,
    ImuNoise,
    as_measured,
    coefficients,
    over_axes,
    wandering,
)
from sinstool.methods.sensor_errors import IMU_GRADES
from tests.helpers.allan import fit_segments, simulate_terms

DT = 0.01


def seen(value: float) -> Coefficient:
    return Coefficient(value, 0.9 * value, 1.1 * value)


def test_si_units_do_not_depend_on_the_rate() -> None:
    """White noise and a random walk of known density, sampled at two rates."""
    density, walk = 2e-4, 1e-4
    for dt in (0.01, 0.04):
        rng = np.random.default_rng(4)
        terms = (0.0, density / np.sqrt(dt), 0.0, walk * np.sqrt(dt), 0.0)
        (fit,) = fit_segments([simulate_terms(round(600.0 / dt), *terms, rng)[:, None]])
        assert fit is not None
        found = coefficients(fit, dt)
        assert found["white"].value == pytest.approx(density, rel=0.02)
        assert found["random_walk"].value == pytest.approx(walk, rel=0.3)
        assert found["random_walk"].low < walk < found["random_walk"].high


def test_over_axes_takes_only_what_shows() -> None:
    hidden = Coefficient(None, 0.0, 9.0)
    noise = {"x": {"flicker": seen(3.0)}, "y": {"flicker": hidden}, "z": {"flicker": seen(4.0)}}
    mean = over_axes(noise, "flicker")
    assert mean is not None
    assert mean.value == pytest.approx(np.sqrt(12.5))
    bound = over_axes({"x": {"flicker": hidden}, "y": {"flicker": Coefficient(None, 0, 7)}},
                      "flicker")  # fmt: skip
    assert bound == Coefficient(None, 0.0, 9.0)
    assert over_axes({}, "flicker") is None


def test_flicker_noise_as_a_markov_process() -> None:
    """Both have the same largest Allan deviation."""
    tau = np.logspace(-2, 2, 4001)  # in correlation times
    allan = 2.0 / tau * (1.0 - (3.0 - 4.0 * np.exp(-tau) + np.exp(-2.0 * tau)) / (2.0 * tau))
    assert 0.6643 / np.sqrt(allan.max()) == pytest.approx(MARKOV_OF_FLICKER, rel=1e-3)


def test_what_no_rest_shows_is_of_the_grade() -> None:
    grade = IMU_GRADES["tactical"]
    below = Coefficient(None, 0.0, 1e3)
    axis = {"white": seen(1e-5), "flicker": below, "random_walk": below}
    noise = ImuNoise({"x": axis}, {"x": axis | {"flicker": seen(2e-4)}}, 100.0)
    errors = as_measured(noise, grade)
    assert errors.angle_random_walk == 1e-5
    in_motion = MANOEUVRE * grade.accel_scale
    assert errors.velocity_random_walk == pytest.approx(np.hypot(1e-5, in_motion))
    assert errors.gyro_instability == grade.gyro_instability
    assert errors.accel_instability == pytest.approx(MARKOV_OF_FLICKER * 2e-4)
    assert errors.gyro_bias == grade.gyro_bias and errors.gyro_scale == grade.gyro_scale
    # Of a filter that has states for them, manoeuvres need no noise
    assert as_measured(noise, grade, scale_states=True).velocity_random_walk == 1e-5


def test_a_bound_below_the_grade_is_taken() -> None:
    axis = {"flicker": Coefficient(None, 0.0, 1e-6), "random_walk": Coefficient(None, 0.0, 1e-8)}
    expected = np.hypot(MARKOV_OF_FLICKER * 1e-6, np.sqrt(50.0) * 1e-8)
    assert wandering({"x": axis}, 1.0, 100.0) == pytest.approx(expected)
    assert wandering({"x": axis}, 1e-9, 100.0) == 1e-9


def test_a_random_walk_drives_the_bias() -> None:
    """The process noise of the filter's state is that of the walk."""
    axis = {"flicker": Coefficient(None, 0.0, 1e-6), "random_walk": seen(3e-6)}
    sigma = wandering({"x": axis}, 1.0, 300.0)
    assert 2.0 * sigma**2 / 300.0 == pytest.approx((3e-6) ** 2)
