"""Slow errors of fixes at rest, drawn from the process that a filter takes them for."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.constraints import STEP_NS
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.methods.land_vehicle.wander import Wander, find_wander
from sinstool.pipelines.process.ins_gnss.vehicle import VehicleAssumptions, VehicleUsed

MODEL = GnssModel(position_white=(0.2, 0.2, 0.3), position_markov=(0.4, 0.4, 0.7))
METRES = 6.371e6
SECOND = 10**9


def fixes_at_rest(seed, factor, seconds=300.0, rest=(20.0, 280.0), stated=np.nan):
    """Rests, and a fix every half second with slow errors so many times those of the model."""
    random = np.random.default_rng([seed, 7])
    step = 0.5
    n = round(seconds / step)
    keep = np.exp(-step / MODEL.position_time)
    slow = random.standard_normal((n, 3))
    for k in range(1, n):
        slow[k] = keep * slow[k - 1] + np.sqrt(1.0 - keep**2) * slow[k]
    error = slow * np.array(MODEL.position_markov) * np.array(factor)
    error += random.standard_normal((n, 3)) * MODEL.position_white
    time_ns = np.round((0.1 + step * np.arange(n)) * SECOND).astype(np.int64)
    grid = STEP_NS * np.arange(round(seconds * SECOND / STEP_NS)) / SECOND
    rests = (grid >= rest[0]) & (grid < rest[1])
    moved = np.where(time_ns < rest[0] * SECOND, -30.0, np.where(time_ns < rest[1] * SECOND, 0, 90))
    latitude = 0.8 + (error[:, 0] + moved) / METRES
    longitude = 0.2 + error[:, 1] / (METRES * np.cos(0.8))
    nothing = np.full((n, 3), np.nan)
    gnss = GnssEpochs(
        time_ns,
        time_ns,
        latitude,
        longitude,
        100.0 + error[:, 2],
        nothing,
        np.full((n, 3), stated),
        nothing,
    )
    return rests, gnss


def test_a_stated_sigma_that_is_right_is_kept():
    wanders = [find_wander(*_asked(seed, (1.0, 1.0, 1.0))) for seed in range(60)]
    # Three sigmas of one parameter, of two factors a log
    assert sum(not w.ordinary for w in wanders) <= 2


@pytest.mark.parametrize("seed", range(4))
def test_heights_that_wander_further_are_seen(seed):
    wander = find_wander(*_asked(seed, (1.0, 1.0, 8.0)))
    assert wander.level == 1.0
    # A dozen fixes that count: a sigma is known to a fifth, and less where they go one way
    assert 3.0 < wander.vertical < 20.0
    assert wander.seconds == pytest.approx(260.0, abs=1.0)
    model = MODEL.with_slow_position(wander.level, wander.vertical)
    assert model.position_markov == pytest.approx((0.4, 0.4, 0.7 * wander.vertical))
    assert model.position_white == MODEL.position_white
    assert "in height" in str(wander) and "north" not in str(wander)


def test_a_rest_shows_wander_however_long_the_errors_in_motion_last():
    """A rest of minutes was too short for errors of an hour, so that none was found."""
    *asked, model = _asked(0, (8.0, 8.0, 8.0))
    wander = find_wander(*asked, model.lasting(3200.0))
    assert wander == find_wander(*asked, model)
    assert wander.level > 3.0


@pytest.mark.parametrize("seed", range(3))
def test_fixes_that_wander_a_hundred_times_as_far_are_seen_whole(seed):
    """At most 32 times were tried, and the rest turned a parked car by 5 deg about its antenna."""
    rests, gnss = fixes_at_rest(seed, (100.0, 100.0, 100.0))
    white = (0.02, 0.02, 0.03)
    wander = find_wander(rests, 0, gnss, 0, replace(MODEL, position_white=white))
    assert 40.0 < wander.level < 250.0 and 40.0 < wander.vertical < 250.0


@pytest.mark.parametrize("given", [True, False])
def test_a_share_of_lasting_noise_that_a_rest_contradicts_is_said(given):
    vehicle = VehicleAssumptions(wander=Wander(40.0, 1.0, 100.0), lasting_given=given)
    found = vehicle.findings(VehicleUsed("none", "", 100.0, "", None))
    assert [finding.kind for finding in found] == ["fixes-wander"] * given
    if given:
        assert "fixes wander 40 times as far north and east, by 100 s of rest" in found[0].text


def test_fixes_that_say_that_they_are_poor_may_wander():
    assert find_wander(*_asked(1, (8.0, 8.0, 8.0), stated=6.0)).ordinary
    assert not find_wander(*_asked(1, (8.0, 8.0, 8.0))).ordinary


def test_a_stop_at_a_light_and_a_log_without_rest_show_nothing():
    assert find_wander(*_asked(0, (8.0, 8.0, 8.0), rest=(20.0, 32.0))).ordinary
    rests, gnss = fixes_at_rest(0, (8.0, 8.0, 8.0))
    assert find_wander(np.zeros_like(rests), 0, gnss, 0, MODEL).ordinary


def test_fixes_are_at_rest_when_they_are_valid():
    """Stamped late, the last of those from before the rest would lie in it, 30 m away."""
    late = 2 * SECOND
    rests, gnss = fixes_at_rest(5, (1.0, 1.0, 1.0))
    gnss = replace(gnss, time_ns=gnss.time_ns + late)
    assert find_wander(rests, 0, gnss, late, MODEL).ordinary
    assert find_wander(rests, 0, gnss, 0, MODEL).level > 4.0


def _asked(seed, factor, **options):
    rests, gnss = fixes_at_rest(seed, factor, **options)
    return rests, 0, gnss, 0, MODEL
