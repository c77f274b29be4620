"""Rest by what the IMU feels, with thresholds from the log itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.methods.ins_gnss.constraints import STEP_NS
from sinstool.methods.land_vehicle.rest import find_rests, noise_at_rest
from sinstool.methods.land_vehicle.track import Means, MeansStage, Track, within
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.logs import memory_below

STEP = STEP_NS * 1e-9


def a_drive(seed=0, idle=0.003, road=0.03, minutes=6.0, sigma=0.05, stops=True):
    """Means and track of a vehicle that drives and stops by turns; when it moves, per step."""
    random = np.random.default_rng(seed)
    n = round(60.0 * minutes / STEP)
    t = STEP * np.arange(n)
    moves = (t % 60.0) < (40.0 if stops else 61.0)
    speed = np.where(moves, np.clip(t % 60.0, 0.0, 10.0) * np.clip(40.0 - t % 60.0, 0, 10) / 10, 0)
    if not stops:
        speed = np.full(n, 12.0)
    shake = np.where(speed > 0.02, road * (0.7 + 0.6 * random.random(n)), idle)[:, None]
    rate = shake * random.standard_normal((n, 3))
    force = 10.0 * shake * random.standard_normal((n, 3)) + [0.0, 0.0, -9.8]
    means = Means(5_000, rate, force)
    rows = slice(None, None, 10)
    velocity = np.zeros((n, 3))
    velocity[:, 0] = speed
    velocity += sigma * random.standard_normal((n, 3)) * 0.3
    covariance = np.zeros((n, 6, 6)) + np.diag([sigma**2] * 3 + [1e-6] * 3)
    track = Track(
        means.time_ns[rows], velocity[rows], np.tile(np.eye(3), (n, 1, 1))[rows], covariance[rows]
    )
    return means, track, speed


@pytest.mark.parametrize("idle", [1e-5, 3e-3])
def test_rests_are_found_and_cut_at_both_ends(idle):
    means, track, speed = a_drive(idle=idle)
    rests = find_rests(means, track)
    assert not rests.at[speed > 0.0].any()
    still = speed == 0.0
    assert rests.at[still].mean() > 0.7
    # not within 0.7 s of a stop, nor 1.2 s before pulling away
    assert not rests.at[within(speed > 0.0, 6, 11)].any()


def test_a_boat_whose_rest_feels_like_motion_never_rests():
    means, track, _ = a_drive(idle=0.03, road=0.02)
    rests = find_rests(means, track)
    assert not rests.at.any()
    assert "look alike" in rests.reason


@pytest.mark.parametrize("rate", [0.02, 0.1, 0.3])
def test_what_turns_on_the_spot_does_not_rest(rate):
    """Smoothly, so that the IMU feels a bias: the attitude of the track turns on."""
    means, track, speed = a_drive()
    turns = (speed == 0.0) & (STEP * np.arange(len(speed)) % 120.0 > 60.0)
    means.rate[turns] += [0.0, 0.0, rate]
    heading = np.zeros((len(turns), 3))
    heading[:, 2] = np.cumsum(np.where(turns, rate, 0.0)) * STEP
    dcm = Rotation.from_rotvec(heading).as_matrix()
    rests = find_rests(means, replace(track, dcm_nb=dcm[::10]))
    assert not (rests.at & turns).any() and not (rests.stands & turns)[20:].all()
    still = (speed == 0.0) & ~turns
    assert rests.at[still].mean() > 0.7
    # A bias alone is no turn
    means, track, speed = a_drive()
    means.rate[:] += [0.0, 0.0, rate]
    assert find_rests(means, track).at[speed == 0.0].mean() > 0.7


@pytest.mark.parametrize("rate", [0.004, -0.006])
def test_one_rest_that_turns_slowly_and_evenly_is_none(rate):
    """Less than a track shows: a robot's 0.35 deg/s became its bias, and its heading was lost."""
    means, track, speed = a_drive(idle=1e-3)
    minute = np.arange(len(speed)) * STEP // 60.0
    turns = (speed == 0.0) & (minute == 3.0) & (np.arange(len(speed)) * STEP % 60.0 < 55.0)
    # What the gyros and the vertical are does not matter
    tilted = Rotation.from_euler("xy", [0.3, -0.2]).as_matrix()
    means.rate[:] = (means.rate + turns[:, None] * [0.0, 0.0, rate]) @ tilted + [0.02, 0.01, -0.03]
    means.force[:] = means.force @ tilted
    rests = find_rests(means, track)
    assert not (rests.at & turns).any()
    assert rests.at[(speed == 0.0) & (minute != 3.0)].mean() > 0.7


def test_biases_of_a_chip_that_warms_up_are_no_turns():
    """Slowly, about the vertical; or at once, about every axis."""
    for change in ([0.0, 0.0, 0.01], [0.004, -0.002, 0.005]):
        means, track, speed = a_drive(idle=1e-3)
        t = np.linspace(0.0, 1.0, len(speed))[:, None]
        means.rate[:] += (t if change[0] == 0.0 else np.round(t)) * change
        assert find_rests(means, track).at[speed == 0.0].mean() > 0.7


@pytest.mark.parametrize("seed", range(3))
def test_what_creeps_on_evenly_does_not_rest(seed):
    """A jib that rises by 4 cm/s beside RTK fixes: they seemed to wander by half a metre."""
    means, track, speed = a_drive(seed, idle=1e-3, sigma=0.003)
    minute, second = np.divmod(np.arange(len(speed)) * STEP, 60.0)
    ramp = np.clip(np.minimum(second - 40.0, 58.0 - second) / 4.0, 0.0, 1.0)
    creep = np.where(np.isin(minute, [1, 4]), 0.04 * ramp, 0.0)
    velocity = track.velocity_n + np.outer(creep[::10], [0.0, 0.0, 1.0])
    rest = find_rests(means, replace(track, velocity_n=velocity)).at
    assert not rest[creep > 0.02].any()
    assert rest[(speed == 0.0) & (creep == 0.0)].mean() > 0.7
    # A receiver that wanders at every rest does not move the vehicle
    wander = 0.04 * np.sin(0.2 * STEP * np.arange(len(speed)))
    velocity = track.velocity_n + np.outer(wander[::10], [1.0, 0.0, 0.0])
    assert find_rests(means, replace(track, velocity_n=velocity)).at[speed == 0.0].mean() > 0.7


def test_fixes_that_move_overrule_a_smooth_road():
    means, track, speed = a_drive()
    smooth = means.rate.copy(), means.force.copy()
    steady = slice(180, 260)  # at 10 m/s, where the IMU feels nothing
    for values in smooth:
        values[steady] = values[500:580]
    rests = find_rests(Means(means.start_ns, *smooth), track)
    assert speed[steady].min() > 5.0 and not rests.at[steady].any()


def test_no_fix_that_stands_gives_half_of_the_least_motion():
    means, track, _ = a_drive(stops=False)
    rests = find_rests(means, track)
    assert "never stand" in rests.reason
    assert not rests.at.any()


def test_means_are_those_of_the_increments():
    random = np.random.default_rng(3)
    interval = np.full(400, 0.01)
    time_ns = 1_000_000_000 + np.round(np.cumsum(interval) * 1e9).astype(np.int64)
    phi, dv = 0.01 * random.standard_normal((2, 400, 3))
    keep = np.r_[0:150, 210:400]  # a gap
    stage = MeansStage(1_000_000_000)
    for part in np.array_split(keep, 7):
        stage.push(Increments(part, time_ns[part], interval[part], phi[part], dv[part]))
    means = stage.finish()
    assert len(means) == 40
    assert means.rate[3] == pytest.approx(phi[30:40].sum(axis=0) / 0.1)
    assert means.force[30] == pytest.approx(dv[300:310].sum(axis=0) / 0.1)
    assert np.isnan(means.rate[15:21]).all() and np.isfinite(means.rate[14]).all()


@pytest.mark.parametrize("longer", [0, 1])
def test_means_are_of_the_longest_part_between_gaps_of_years(longer):
    """A clock that is set while recording makes such a gap."""
    count = (300, 200) if longer == 0 else (200, 300)
    interval = np.full(500, 0.01)
    time_ns = np.round(np.cumsum(interval) * 1e9).astype(np.int64)
    time_ns[count[0] :] += 10**18
    phi, dv = np.random.default_rng(3).standard_normal((2, 500, 3))
    stage = MeansStage(0)
    with memory_below(2**22):
        for part in np.array_split(np.arange(500), 3):
            stage.push(Increments(part, time_ns[part], interval[part], phi[part], dv[part]))
        means = stage.finish()
    first = 0 if longer == 0 else count[0]
    assert len(means) == 30 and np.isfinite(means.rate).all()
    assert means.start_ns == (0 if longer == 0 else 10**18 + 2 * 10**9)
    assert means.rate[0] == pytest.approx(phi[first : first + 10].sum(axis=0) / 0.1)


def test_noise_at_rest_is_that_of_its_seconds():
    """White noise of a known density, motion between, and a few people who step in."""
    means, _, speed = a_drive(seed=3, minutes=20.0)
    random = np.random.default_rng(4)
    still = speed == 0.0
    force, rate = 0.03, 0.001  # (m/s)/sqrt(s), rad/sqrt(s)
    means.force[still] = random.standard_normal((still.sum(), 3)) * force / np.sqrt(STEP)
    means.rate[still] = random.standard_normal((still.sum(), 3)) * rate / np.sqrt(STEP)
    means.force[still] += random.standard_normal(3)  # gravity and biases
    means.force[np.flatnonzero(still)[200:220]] += 1.0
    shown = noise_at_rest(means, still)
    assert np.sqrt(shown) == pytest.approx((force, rate), rel=0.15)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hertz", [2.3, 2.7, 3.4])
def test_a_tone_adds_nothing_to_the_noise_at_rest(seed, hertz):
    """An engine's, as means of a tenth of a second alias it: what it turns it turns back."""
    means, _, speed = a_drive(seed=seed, minutes=20.0)
    random = np.random.default_rng(seed)
    still, n = speed == 0.0, len(speed)
    force, rate = 0.03, 0.001  # (m/s)/sqrt(s), rad/sqrt(s)
    tone = np.sin(2.0 * np.pi * (hertz * STEP * np.arange(n)[:, None] + [0.0, 0.3, 0.6]))
    for values, density in ((means.force, force), (means.rate, rate)):
        white = density / np.sqrt(STEP)
        values[:] = white * (random.standard_normal((n, 3)) + 3.0 * tone)
    assert np.sqrt(noise_at_rest(means, still)) == pytest.approx((force, rate), rel=0.12)


@pytest.mark.parametrize("seed", range(6))
def test_an_imu_stands_as_long_as_it_is_shaken(seed):
    """An engine that runs smoothly as soon as the car creeps, which no window of 1 s shows."""
    means, track, speed = a_drive(seed=seed, minutes=12.0)
    moves = speed > 0.0
    creeps = moves & within(~moves, 10, 10)
    for values in (means.rate, means.force):
        level = np.median(values, axis=0)
        values[creeps] = level + 0.1 * (values[creeps] - level) * 3e-3 / 3e-2
    stands = find_rests(means, track).stands
    assert creeps.sum() > 200 and stands[~moves].mean() > 0.99
    beside = within(~moves, 4, 4) | within(moves & ~creeps, 4, 4)
    assert not (stands & creeps & ~beside).any()


def test_too_short_rests_show_no_noise():
    means, _, speed = a_drive(minutes=1.0)
    assert noise_at_rest(means, (speed == 0.0) & (np.arange(len(speed)) % 15 > 0)) == (0.0, 0.0)
