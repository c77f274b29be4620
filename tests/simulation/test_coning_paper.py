import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import quad_vec

from sinstool.cli.simulate import command
from sinstool.config import ProcessConfig
from sinstool.core import rotation
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.gyro_response import butterworth, chebyshev, none
from sinstool.pipelines.compare_coning.paper_experiment import noise_rate_deg
from sinstool.pipelines.info.run import inspect
from sinstool.simulation.coning_paper import (
    cone,
    coning_paper,
    paper_response,
    response_name,
)
from sinstool.simulation.truth import sample_times

THETA, W = np.deg2rad(0.1), 2 * np.pi * 30.0
THETA_N = np.deg2rad(0.01)
TIMES = sample_times(400.0, 0.1, start_ns=17)
T = (TIMES - TIMES[0]) * 1e-9


def attitude(t):
    """Eq. 19 of the paper, away from any grid."""
    return rotation.exp(THETA * np.array([np.sin(W * t), np.cos(W * t), 0.0]))


def test_cone_is_equation_19():
    truth = cone(TIMES)
    np.testing.assert_allclose(truth.q_nb, [attitude(t) for t in T], atol=1e-14)
    still = rotation.rotate(rotation.conjugate(truth.q_nb), [0.0, 0.0, -9.80665])
    np.testing.assert_allclose(truth.specific_force, still, atol=1e-12)


def test_rate_is_the_derivative_of_the_attitude():
    truth = cone(TIMES)
    h = 1e-4
    for t, rate in zip(T, truth.gyro_rate, strict=True):
        # a fourth-order difference: h**4 W**5 / 30 of the angle is 1e-8 rad/s
        steps = [
            rotation.log(rotation.multiply(rotation.conjugate(attitude(t)), attitude(t + k * h)))
            for k in (-2, -1, 1, 2)
        ]
        derivative = (steps[0] - 8 * steps[1] + 8 * steps[2] - steps[3]) / (12 * h)
        np.testing.assert_allclose(rate, derivative, atol=5e-8)


@pytest.mark.parametrize("phase", ["consistent", "literal"])
@pytest.mark.parametrize("noise_frequency", [0.0, 30.0, 123.4, 400.0, 930.0])
def test_increments_are_the_integral_of_the_measured_rate(phase, noise_frequency):
    response = chebyshev(6, 0.2, 200.0)
    _, sensor = coning_paper(TIMES, noise_frequency, phase=phase, response=response)
    g, gn = response([30.0, noise_frequency])
    wn = 2 * np.pi * noise_frequency

    def rate(t):
        a, b = g * W, gn * THETA_N * wn
        if phase == "literal":  # eq. 20 to the letter
            return np.array(
                [
                    a * THETA * np.sin(W * t) + b * np.sin(wn * t),
                    a * THETA * np.cos(W * t) + b * np.cos(wn * t),
                    0.5 * THETA**2 * g**2 * W + 0.5 * THETA_N**2 * gn**2 * wn,
                ]
            )
        return np.array(
            [
                a * np.sin(THETA) * np.cos(W * t) + b * np.cos(wn * t),
                -a * np.sin(THETA) * np.sin(W * t) - b * np.sin(wn * t),
                2 * W * np.sin(THETA / 2) ** 2,
            ]
        )

    np.testing.assert_allclose(sensor.gyro_rate, [rate(t) for t in T], atol=1e-11)
    for k in range(1, 12):
        integral = quad_vec(rate, T[k - 1], T[k], epsrel=1e-12)[0]
        np.testing.assert_allclose(sensor.gyro_increment[k], integral, atol=1e-13)
        np.testing.assert_allclose(sensor.gyro_mean_rate[k] * 0.0025, integral, atol=1e-13)


def test_without_noise_and_filter_the_gyro_measures_the_motion():
    truth, sensor = coning_paper(TIMES, 77.0, response=none(), noise_angle=0.0)
    np.testing.assert_allclose(sensor.gyro_rate, truth.gyro_rate, atol=1e-14)
    np.testing.assert_allclose(sensor.gyro_increment, truth.gyro_increment, atol=1e-16)
    # to the letter the measured rate is a quarter of a turn behind
    _, literal = coning_paper(TIMES, 77.0, phase="literal", response=none(), noise_angle=0.0)
    behind = np.stack([-truth.gyro_rate[:, 1], truth.gyro_rate[:, 0]], axis=-1)
    np.testing.assert_allclose(literal.gyro_rate[:, :2], behind, rtol=1e-5, atol=1e-14)


def test_noise_sampled_at_its_own_frequency_is_a_constant_rate():
    truth, sensor = coning_paper(TIMES, 400.0, response=none())
    extra = sensor.gyro_rate - truth.gyro_rate
    np.testing.assert_allclose(extra[:, 0], THETA_N * 2 * np.pi * 400.0, rtol=1e-9)
    np.testing.assert_allclose(extra[:, 1:], 0.0, atol=1e-9)
    # and has no increments
    np.testing.assert_allclose(sensor.gyro_increment, truth.gyro_increment, atol=1e-14)


@pytest.mark.parametrize(
    ("response", "at_400", "at_800"),
    [
        (chebyshev(5, 0.2, 200.0), ".187", None),
        (chebyshev(6, 0.2, 200.0), ".0557", ".0013"),
        (chebyshev(7, 0.2, 200.0), ".0155", None),
        (chebyshev(8, 0.2, 200.0), ".0045", None),
        (chebyshev(9, 0.2, 200.0), ".0012", None),
        (butterworth(8, 200.0), ".098", None),
        (butterworth(9, 200.0), ".049", None),
        (butterworth(10, 200.0), ".0245", None),
    ],
    ids=lambda v: getattr(v, "name", v),
)
def test_noise_behind_the_filters(response, at_400, at_800):
    for frequency, expected in ((400.0, at_400), (800.0, at_800)):
        if expected is not None:
            digits = len(expected) - 1
            assert round(noise_rate_deg(response, frequency), digits) == float(expected)
    assert response(0.0) == pytest.approx(1.0, abs=1e-12)


def test_short_names_of_responses():
    assert paper_response("cheb:6").name == "cheb:6,0.2,200"
    assert paper_response("butter:9").name == "butter:9,200"
    for text in ("cheb:6", "butter:9", "none", "cheb:6,0.5,200", "cheb:6,0.2,150", "butter:3,50"):
        assert response_name(paper_response(text)) == text
    with pytest.raises(ConfigurationError, match="cheb"):
        paper_response("cheb:")


def test_unknown_phase_is_refused():
    with pytest.raises(ValueError, match="phase"):
        coning_paper(TIMES, 1.0, phase="other")


def test_command_writes_noise_beside_exact_truth(tmp_path):
    path = tmp_path / "log.mcap"
    arguments = ["coning-paper", "-o", str(path), "--duration", "2", "--noise-frequency", "400"]
    arguments += ["--noise-deg", "0.02", "--gyro-response", "butter:9", "--json"]
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    written = json.loads(result.stdout)
    assert written["settings"]["gyro_response"] == "butter:9"
    assert written["settings"]["noise_deg"] == "0.02"
    assert written["topics"]["/imu/data_raw"] == 801
    imu = inspect(path, ProcessConfig()).usable[0]
    # FLU: x as in FRD. The cone's largest rate and the noise's constant one add up.
    noise = np.deg2rad(0.02) * 2 * np.pi * 400.0 * butterworth(9, 200.0)(400.0)
    assert imu.gyro_max_rad_s[0] == pytest.approx(W * THETA + noise, rel=1e-4)
    assert imu.gyro_max_rad_s[1] == pytest.approx(W * THETA, rel=1e-4)


@pytest.mark.parametrize(
    "bad",
    [
        ["--noise-frequency", "-1"],
        ["--noise-deg", "90"],
        ["--phase", "other"],
        ["--gyro-response", "cheb:0"],
        ["--half-angle-deg", "0"],
        ["--frequency", "nan"],
    ],
    ids=lambda v: v[0],
)
def test_command_refuses_the_impossible(tmp_path, bad):
    path = tmp_path / "log.mcap"
    result = CliRunner().invoke(command, ["coning-paper", "-o", str(path), *bad])
    assert result.exit_code == 2 or isinstance(result.exception, ConfigurationError)
    assert not path.exists()
