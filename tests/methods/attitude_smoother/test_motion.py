"""The search for the density of a motion's accelerations, and the first tilt of its filter."""

from math import exp, log

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.attitude_smoother import motion
from sinstool.methods.attitude_smoother.model import FOLLOWER, HAND, VEHICLE, sensor_model
from sinstool.methods.attitude_smoother.motion import GRID, SECOND, most_likely_density
from sinstool.methods.attitude_smoother.start import upright
from tests.helpers.matched_motion import drawn, epochs_of

SENSORS = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)


@pytest.fixture(scope="module", params=[(HAND, 1.0), (VEHICLE, 0.5)], ids=["hand", "vehicle"])
def epochs(request):
    model, share = request.param
    shaken = model.with_density(share * model.density)
    return epochs_of(drawn(shaken, SENSORS, 120.0, 7).solution)


@pytest.mark.parametrize("model", [HAND, VEHICLE, FOLLOWER], ids=["hand", "vehicle", "follower"])
def test_a_search_ends_at_the_same_density_from_wherever_it_begins(epochs, model):
    density, likelihood = most_likely_density([epochs], model, SENSORS)
    number = log(density / HAND.density) / GRID
    assert abs(number - round(number)) < 1e-9
    for away in (-5, -1, 0, 1, 5):
        near = density * exp(GRID * away)
        assert most_likely_density([epochs], model, SENSORS, near) == (density, likelihood)
    # and there it is likeliest
    for other in (density * exp(GRID * away) for away in (-1, 1)):
        assert motion.filtered(epochs, model.with_density(other), SENSORS) < likelihood


def test_a_search_that_begins_near_looks_less_often(epochs, monkeypatch):
    looked = []
    filtered = motion.filtered
    monkeypatch.setattr(motion, "filtered", lambda *args: looked.append(1) or filtered(*args))
    longer = most_likely_density([motion.merged(epochs, SECOND)], VEHICLE, SENSORS)[0]
    counts = []
    for near in (None, longer):
        looked.clear()
        most_likely_density([epochs], VEHICLE, SENSORS, near)
        counts.append(len(looked))
    assert counts[1] <= counts[0]


def test_no_start_where_a_filter_diverges_is_taken_for_near(epochs, monkeypatch):
    filtered = motion.filtered
    floor = 0.1

    def diverging(part, model, sensors):
        return filtered(part, model, sensors) if model.density > floor else motion.DIVERGED

    monkeypatch.setattr(motion, "filtered", diverging)
    without = most_likely_density([epochs], VEHICLE, SENSORS)
    assert most_likely_density([epochs], VEHICLE, SENSORS, 0.5 * floor) == without


def test_the_first_tilt_is_the_shortest_turn_upwards():
    random = np.random.default_rng(3)
    up = np.array([0.0, 0.0, -1.0])
    forces = [*random.normal(size=(50, 3)), [1e-9, 0.0, -9.8], [1e-7, 2e-7, 9.8], [3.0, 0.0, 0.0]]
    for force in np.array(forces):
        c = upright(force)
        unit = force / np.linalg.norm(force)
        assert np.allclose(c @ unit, up, atol=1e-12)
        assert np.allclose(c @ c.T, np.eye(3), atol=1e-9)
        turned = Rotation.from_matrix(c).magnitude()
        assert turned == pytest.approx(np.arccos(np.clip(unit @ up, -1.0, 1.0)), abs=1e-6)
    assert np.array_equal(upright(np.array([0.0, 0.0, -9.8])), np.eye(3))
    assert np.array_equal(upright(np.array([0.0, 0.0, 9.8])), np.diag([1.0, -1.0, -1.0]))
    assert np.array_equal(upright(np.zeros(3)), np.eye(3))
