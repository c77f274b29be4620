"""The attitude smoother on motion and sensors of its own model, and against dense least squares."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.rotation import conjugate, exp, from_dcm, log, multiply, rotate, to_dcm
from sinstool.methods.attitude_smoother import filter_step, smoother, state
from sinstool.methods.attitude_smoother.epochs import (
    AT_REST,
    COUNT,
    DP,
    DURATION,
    DV,
    GYRO,
    JB,
    MOVING,
    REST,
    W2,
    merged,
)
from sinstool.methods.attitude_smoother.heading_update import NO_FIELD
from sinstool.methods.attitude_smoother.model import (
    EPOCH_S,
    FOLLOWER,
    GRAVITY,
    HAND,
    VEHICLE,
    SensorModel,
)
from sinstool.methods.attitude_smoother.rest import confirmed, with_rest
from sinstool.methods.attitude_smoother.start import first_state, parameters
from tests.helpers.matched_motion import drawn, epochs_of, tilt_error

# No bias of the accelerometers: for that of a hand the smoother has no state, and only adds it to
# its sigma.
SENSORS = SensorModel(bias=0.005, accel_bias=0.0)
UNKNOWN_BIAS = replace(SENSORS, bias=0.03)
# For that of a vehicle it has. To the sigma it adds the constant part of errors that grow with the
# rate, which is none here: what is drawn is noise.
BIASED = replace(SENSORS, accel_bias=0.05, rate_error=5e-4)
CASES = {
    "hand": (HAND, SENSORS, 1.0),
    "vehicle": (VEHICLE, SENSORS, 0.1),
    "gentle vehicle": (VEHICLE.with_density(2.0), SENSORS, 0.1),
    "vehicle that goes where it points": (FOLLOWER, SENSORS, 0.1),
    "it goes where it points, bias unknown": (FOLLOWER, UNKNOWN_BIAS, 0.1),
    "hand, bias unknown": (HAND, UNKNOWN_BIAS, 1.0),
    "vehicle, bias unknown": (VEHICLE, UNKNOWN_BIAS, 0.1),
    "vehicle, biased accelerometers": (VEHICLE, BIASED, 0.1),
    "it goes where it points, biased accelerometers": (FOLLOWER, BIASED, 0.1),
}


def consistency(case, seeds):
    """Squared errors over their covariance of tilt and bias, and shares within sigmas, by run."""
    motion, sensors, turning = CASES[case]
    tilts, biases, shares = [], [], []
    for seed in seeds:
        log_ = drawn(motion, sensors, 240.0, seed, turning=turning)
        found = smoother.smooth(epochs_of(log_.solution), motion, sensors)
        after = found.apply(log_.solution)
        rows = np.arange(0, len(after), 50)
        tilt, _ = tilt_error(log_.q_nb[rows], after.q_nb[rows])
        level = after.covariance_attitude_n[rows][:, :2, :2]
        tilts.append(np.mean(np.einsum("ni,nij,nj->n", tilt, np.linalg.inv(level), tilt)) / 2.0)
        over = np.abs(tilt) / np.sqrt(np.einsum("nii->ni", level))
        shares.append([np.mean(over < k) for k in (1.0, 2.0, 3.0)])
        at = np.searchsorted(found.time_ns, log_.solution.time_ns[rows])
        off = (log_.bias[rows] - found.gyro_bias[at]) / found.gyro_bias_sigma[at]
        biases.append(np.mean(off**2))
    return np.array(tilts), np.array(biases), np.array(shares)


def is_one(values, error):
    """Whether their mean is 1 to three standard errors, which themselves are no more than so."""
    own = values.std(ddof=1) / np.sqrt(len(values))
    return own < error and abs(values.mean() - 1.0) < 3.0 * own


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_errors_are_as_large_as_the_covariance_says(case):
    # A run gives one bias of each axis, and hardly more tilts of a vehicle, but many of a hand. How
    # much runs differ shows what the mean of so few is worth; the slow test has the narrow band.
    runs = 16 if "hand" in case else 36
    tilt, bias, shares = consistency(case, range(runs))
    assert is_one(tilt, 0.05 if "hand" in case else 0.2)
    assert is_one(bias, 2.0 * np.sqrt(2.0 / (3.0 * runs)))
    assert np.all(np.abs(shares.mean(axis=0) - [0.683, 0.954, 0.997]) < [0.08, 0.04, 0.02])


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_errors_are_as_large_as_the_covariance_says_in_many_runs(case):
    tilt, bias, shares = consistency(case, range(1000, 1400))
    # Where neither the first tilt nor the bias is known, and a wrong bias turns the velocity,
    # few runs settle on a wrong minimum.
    lost = tilt > 10.0
    assert np.mean(lost) <= (0.015 if case == "it goes where it points, bias unknown" else 0.0)
    assert 0.9 < tilt[~lost].mean() < 1.1
    # One bias a run: 400 runs give their mean to 0.06, but for what turns a velocity, or tilts far
    bias = bias[~lost]
    curved = "points" in case or case == "vehicle, bias unknown"
    error = 2.0 * bias.std(ddof=1) / np.sqrt(len(bias)) if curved else 0.0
    assert error < 0.15 and abs(bias.mean() - 1.0) < 0.1 + error
    off = np.abs(shares[~lost].mean(axis=0) - [0.683, 0.954, 0.997])
    assert np.all(off < [0.03, 0.015, 0.008])


# --- heading ----------------------------------------------------------------------------------


def one_step(epoch, motion, sensors, x, p):
    """Transition, and covariance after an epoch's measurements, by the filter itself."""
    n = motion.states
    dx, gain = np.zeros(state.ERRORS), np.empty(state.ERRORS)
    f, q, scratch = np.empty((n, n)), np.empty((n, n)), np.empty((3, 3))
    par = parameters(motion, sensors)
    x, p = x.copy(), p.copy()
    filter_step.measure(epoch, NO_FIELD, 0, par, n, x, p, gain, dx, f, int(epoch[REST]))
    filter_step.predict_state(epoch, 0.0, par, n, x, f, q, scratch)
    return f, q, p, dx


@pytest.mark.parametrize("motion", [HAND, VEHICLE, FOLLOWER], ids=["hand", "vehicle", "follower"])
@pytest.mark.parametrize("rest", [False, True])
def test_nothing_is_ever_learnt_of_heading(motion, rest):
    log_ = drawn(motion, SENSORS, 30.0, 5, turning=0.5)
    epochs = epochs_of(log_.solution)
    x, p = first_state(epochs, motion, SENSORS)
    random = np.random.default_rng(1)
    x[9:12], x[12:15], x[16:19] = random.normal(0.0, [[3.0], [0.01], [0.5]], (3, 3))
    p[2, 2] = 0.3**2
    row = epochs.values[20].copy()
    row[REST] = AT_REST if rest else MOVING
    row[GYRO : GYRO + 3] = x[12:15]
    f, q, after, dx = one_step(row, motion, SENSORS, x, p)
    # An error of heading alone stays one of heading alone...
    assert np.array_equal(f[:, 2], np.eye(motion.states)[2])
    # ... and no measurement sees it: what it is independent of keeps it as it is, to the last bit.
    assert after[2, 2] == p[2, 2]
    assert np.array_equal(after[2], p[2])
    assert dx[2] == 0.0
    assert np.all(np.diag(after) <= np.diag(p)) and after[0, 0] < p[0, 0]
    assert q[2, 2] > 0.0


def test_heading_gets_less_certain_by_the_noise_of_the_gyros_alone():
    known = replace(SENSORS, bias=0.0, bias_walk=0.0, gyro_scale=0.0, gyro_misalignment=0.0)
    log_ = drawn(VEHICLE, known, 120.0, 2, turning=0.3)
    epochs = epochs_of(log_.solution)
    heading = smoother.smooth(epochs, VEHICLE, known).covariance_n[:, 2, 2]
    walk = parameters(VEHICLE, known)[filter_step.WALK]
    rows = merged(epochs, smoother.COARSE).values
    noise = walk**2 * rows[:, DURATION] + known.rate_error**2 * rows[:, W2]
    expected = 1e-8 + np.concatenate([[0.0], np.cumsum(noise)])
    assert heading == pytest.approx(expected, rel=1e-5)


# --- the same by other means ------------------------------------------------------------------


def dense(rows, motion, sensors, x0, p0, passes=6):
    """Smoothed tilt and covariance of all epochs at once, by least squares over all errors.

    Gauss-Newton on the whole log with derivatives by differences: no filter, no recursion, no
    Jacobian that anybody derived. Unknowns are the states before every epoch and after the last.
    """
    n, count = motion.states, len(rows)
    noise = np.array(
        [
            np.concatenate(
                [
                    np.full(3, sensors.angle_random_walk**2 * t + sensors.rate_error**2 * w2),
                    np.full(3, sensors.velocity_walk**2 * t),
                    np.full(3, sensors.bias_walk**2 * t),
                    [sensors.gravity_walk**2 * t],
                    np.full(n - 10, 1e-8),  # the position has no noise: a micrometre or so
                ]
            )
            for t, w2 in rows[:, [DURATION, W2]]
        ]
    )

    def plus(here, d):
        """The state that is off by d."""
        c, v, b, g, p = here
        e = exp(d[:3])
        p = rotate(e, p) + d[10:] if n > 10 else p
        return multiply(e, c), rotate(e, v) + d[3:6], b + d[6:9], g + d[9], p

    def less(a, b):
        e = log(multiply(a[0], conjugate(b[0])))
        q = exp(e)
        d = [e, a[1] - rotate(q, b[1]), a[2] - b[2], [a[3] - b[3]]]
        return np.concatenate(d + ([a[4] - rotate(q, b[4])] if n > 10 else []))

    down = np.array([0.0, 0.0, 1.0])

    def ahead(here, row):
        c, v, b, g, p = here
        t = row[DURATION]
        turn = row[JB : JB + 9].reshape(3, 3) @ b
        dv = row[DV : DV + 3] - 0.5 * np.cross(turn, row[DV : DV + 3])
        dp = row[DP : DP + 3] - np.cross(turn, row[DP : DP + 3]) / 3.0
        weight = (GRAVITY + g) * down
        return (
            multiply(c, exp(-turn)),
            v + rotate(c, dv) + t * weight,
            b,
            g,
            p + t * v + rotate(c, dp) + 0.5 * t * t * weight,
        )

    def shaken(here, row):
        c, v, b, g, p = here
        turn = row[JB : JB + 9].reshape(3, 3) @ b
        dv = row[DV : DV + 3] - 0.5 * np.cross(turn, row[DV : DV + 3])
        weight = (GRAVITY + g) * down
        return rotate(c, dv) / row[DURATION] + weight + motion.c1 * v + motion.c0 * p

    def slope(function, here):
        h = 1e-6
        return np.stack(
            [(function(plus(here, s)) - function(plus(here, -s))) / 2.0 / h for s in h * np.eye(n)],
            1,
        )

    def shaken_in_its_axes(here, row, c):
        """Alike in every direction, it may be seen in axes that are turned back."""
        return rotate(multiply(c, conjugate(here[0])), shaken(here, row))

    states = [x0]
    for row in rows:
        states.append(ahead(states[-1], row))
    size = n * (count + 1)
    for _ in range(passes):
        normal, right = np.zeros((size, size)), np.zeros(size)

        def add(at, jacobian, residual, inverse, normal=normal, right=right):
            w = jacobian.T @ inverse
            normal[np.ix_(at, at)] += w @ jacobian
            right[at] -= w @ residual

        one = np.arange(n)
        first = states[0]
        add(one, slope(lambda s: less(s, x0), first), less(first, x0), np.linalg.inv(p0))
        for k, row in enumerate(rows):
            here, there = states[k], states[k + 1]
            r = motion.density**2 / row[DURATION]
            seen = slope(lambda s, row=row, c=here[0]: shaken_in_its_axes(s, row, c), here)
            add(n * k + one, seen, shaken(here, row), np.eye(3) / r)
            spread = np.eye(n)
            led = ahead(here, row)
            spread[3:6, :3] = np.cross(np.eye(3), led[1])
            if n > 10:
                spread[10:, :3] = np.cross(np.eye(3), led[4])
            q = spread @ np.diag(noise[k]) @ spread.T
            jacobian = np.hstack(
                [
                    slope(lambda s, row=row, there=there: less(ahead(s, row), there), here),
                    slope(lambda s, led=led: less(led, s), there),
                ]
            )
            both = np.concatenate([n * k + one, n * (k + 1) + one])
            add(both, jacobian, less(led, there), np.linalg.inv(q))
        step = np.linalg.solve(normal, right).reshape(-1, n)
        states = [plus(s, d) for s, d in zip(states, step, strict=True)]
    return states, np.linalg.inv(normal)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [HAND, VEHICLE], ids=lambda m: m.name)
def test_the_smoother_is_the_least_squares_solution_of_all_epochs(motion, monkeypatch):
    # iterated to the end, for least squares are
    monkeypatch.setattr(smoother, "LARGE_BIAS", 0.0)
    monkeypatch.setattr(smoother, "CLOSE", 1e-12)
    monkeypatch.setattr(smoother, "COARSE", 1)
    # of one model alone
    monkeypatch.setattr(smoother, "_widened", lambda best, found: best)
    log_ = drawn(motion, SENSORS, 3.0, 3, turning=0.5)
    epochs = epochs_of(log_.solution)
    found = smoother.smooth(epochs, motion, SENSORS)
    x, p = first_state(epochs, motion, SENSORS)
    begin = (from_dcm(x[:9].reshape(3, 3)), x[9:12], x[12:15], x[15], x[16:19])
    states, covariance = dense(epochs.values, motion, SENSORS, begin, p)
    n = motion.states
    sigma = np.sqrt(np.diag(covariance).reshape(-1, n))
    for k, one in enumerate(states):
        off = log(multiply(one[0], conjugate(found.q[k])))
        assert np.all(np.abs(off[:2]) < 0.01 * sigma[k, :2])
        assert np.all(np.abs(one[2] - found.gyro_bias[k]) < 0.02 * sigma[k, 6:9])
        tilt = covariance[n * k : n * k + 2, n * k : n * k + 2]
        # the filter leaves out what the bias' own uncertainty does within a measured epoch
        assert found.covariance_n[k, :2, :2] == pytest.approx(tilt, rel=0.05, abs=0.01 * tilt[0, 0])


# --- segments, blocks, gaps, rests ------------------------------------------------------------


@pytest.mark.parametrize("case", ["hand", "vehicle, bias unknown"])
def test_segments_make_no_difference(case, monkeypatch):
    motion, sensors, turning = CASES[case]
    log_ = drawn(motion, sensors, 300.0, 4, turning=turning, rests=[(100.0, 110.0)])
    epochs = confirmed(with_rest(epochs_of(log_.solution)), sensors)
    assert len(epochs) > 2 * smoother.SEGMENT
    by_segments = smoother.smooth(epochs, motion, sensors)
    monkeypatch.setattr(smoother, "SEGMENT", len(epochs))
    whole = smoother.smooth(epochs, motion, sensors)
    assert np.max(np.abs(log(multiply(whole.q, conjugate(by_segments.q))))) < 1e-10
    assert np.max(np.abs(whole.covariance_n / by_segments.covariance_n - 1.0)) < 1e-6
    assert np.max(np.abs(whole.gyro_bias - by_segments.gyro_bias)) < 1e-10


@given(st.lists(st.integers(1, 1000), max_size=8).map(sorted))
def test_epochs_do_not_depend_on_blocks(limits):
    solution = drawn(HAND, SENSORS, 20.0, 6, turning=1.0).solution
    kept = np.ones(len(solution), bool)
    kept[400:430] = False  # a gap
    solution = solution.rows(kept)
    limits = [k for k in limits if k < len(solution)]
    whole, parts = epochs_of(solution), epochs_of(solution, limits)
    assert np.array_equal(whole.time_ns, parts.time_ns)
    assert np.array_equal(whole.values, parts.values)
    assert whole.gap.sum() == 1


def test_epochs_hold_the_integrals_of_their_samples():
    solution = drawn(HAND, SENSORS, 4.0, 7, turning=1.0).solution
    rows = epochs_of(solution).values
    dt = 0.02
    q = solution.q_nb
    middle = q[:-1] + q[1:]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    force = rotate(middle, solution.specific_force_b[1:]).reshape(-1, 10, 3)
    assert np.all(rows[:, COUNT] == 10)
    assert rows[:, DURATION] == pytest.approx(EPOCH_S)
    assert rows[:, DV : DV + 3] == pytest.approx(force.sum(axis=1) * dt)
    velocity = np.cumsum(force, axis=1) * dt - 0.5 * force * dt  # half way through each sample
    assert rows[:, DP : DP + 3] == pytest.approx(velocity.sum(axis=1) * dt)
    turned = to_dcm(middle).reshape(-1, 10, 9).sum(axis=1) * dt
    assert rows[:, JB : JB + 9] == pytest.approx(turned)
    rate = solution.omega_ib_b[1:].reshape(-1, 10, 3)
    assert rows[:, W2] == pytest.approx(np.sum(rate**2, axis=(1, 2)) * dt)
    assert rows[:, GYRO : GYRO + 3] == pytest.approx(rate.mean(axis=1))


@pytest.mark.parametrize("seconds", [1.0, 5.0])
def test_tilt_comes_back_after_a_gap(seconds):
    motion, sensors, _ = CASES["hand"]
    squares = []
    for seed in range(12):
        log_ = drawn(motion, sensors, 90.0, seed, turning=0.5)
        t = log_.solution.time_ns * 1e-9
        kept = (t < 45.0) | (t > 45.0 + seconds)
        before = log_.solution.rows(kept)
        # across the gap the integration holds the attitude
        q, late = before.q_nb.copy(), t[kept] > 45.0
        q[late] = multiply(multiply(q[~late][-1], conjugate(q[late][0])), q[late])
        before = replace(before, q_nb=q)
        epochs = epochs_of(before)
        assert epochs.gap.sum() == 1
        after = smoother.smooth(epochs, motion, sensors).apply(before)
        near = np.flatnonzero((t[kept] > 45.0) & (t[kept] < 60.0 + seconds))
        rows = near[:: len(near) // 20]
        tilt, _ = tilt_error(log_.q_nb[kept][rows], after.q_nb[rows])
        sigma = np.sqrt(np.einsum("nii->ni", after.covariance_attitude_n[rows])[:, :2])
        assert np.all(np.abs(tilt) < 5.0 * sigma)
        assert np.all(sigma < np.radians(4.0))
        # of heading the filter says that it is lost
        lost = min(0.5 * seconds, 0.99 * smoother.UNKNOWN_ANGLE)
        assert after.covariance_attitude_n[near[0], 2, 2] > lost**2
        squares.append(np.mean((tilt / sigma) ** 2))
    assert 0.5 < np.mean(squares) < 1.5


def test_a_log_that_rests_only_at_its_end():
    # The bias is large, and nothing shows it before the end; the attitude integrated from the
    # first instant is far off by then.
    motion, sensors, _ = CASES["hand, bias unknown"]
    log_ = drawn(motion, sensors, 120.0, 8, turning=0.5, rests=[(110.0, 120.0)])
    epochs = confirmed(with_rest(epochs_of(log_.solution)), sensors)
    resting = (epochs.time_ns[:-1] >= 110_000_000_000) & (epochs.time_ns[1:] <= 120_000_000_000)
    assert not np.any(epochs.rest[~resting])
    assert np.mean(epochs.rest[resting]) > 0.4  # noise hides some
    found = smoother.smooth(epochs, motion, sensors)
    after = found.apply(log_.solution)
    before, _ = tilt_error(log_.q_nb, log_.solution.q_nb)
    tilt, heading = tilt_error(log_.q_nb, after.q_nb)
    sigma = np.sqrt(np.einsum("nii->ni", after.covariance_attitude_n))
    assert np.abs(before).max() > np.radians(20.0)
    assert np.sqrt(np.mean(tilt**2)) < np.radians(1.0)
    assert np.sqrt(np.mean((tilt / sigma[:, :2]) ** 2)) < 1.5
    assert np.abs(found.gyro_bias[-1] - log_.bias[-1]).max() < 5e-4
    # the rest shows the bias about the vertical too: heading holds from the first instant
    rows = slice(100, None)
    assert np.sqrt(np.mean((heading[rows] / sigma[rows, 2]) ** 2)) < 3.0
    assert np.abs(heading).max() < np.radians(10.0)


@pytest.mark.parametrize("grade", [0.02, 0.3])
def test_gravity_in_a_log_shows_one_of_four_axes_of_accelerometers(grade):
    """The mean square of three biases as graded, and of the one that is seen."""
    for seen in (0.0, grade, -5.0 * grade):
        found = smoother.accel_bias_sigma(grade, 9.82 + seen, 9.82)
        assert found == pytest.approx(np.sqrt(np.mean([grade**2, grade**2, grade**2, seen**2])))
        # Without the local gravity as much counts as no place on Earth has
        wide = smoother.MEAN_GRAVITY + np.sign(seen) * (smoother.GRAVITY_RANGE + abs(seen))
        assert smoother.accel_bias_sigma(grade, wide, None) == pytest.approx(found)
    near = smoother.MEAN_GRAVITY + 0.9 * smoother.GRAVITY_RANGE
    assert smoother.accel_bias_sigma(grade, near, None) == pytest.approx(np.sqrt(0.75) * grade)
    assert smoother.accel_bias_sigma(0.0, 9.0, 9.8) == 0.0


@pytest.mark.parametrize("grade", [0.03, 0.3])
def test_a_vehicle_that_turns_about_shows_the_bias_of_its_accelerometers(grade):
    """Also where it is many times that of the grade, which then says nothing of the others."""
    off, sigmas = [], []
    for seed in range(6):
        drives = replace(SENSORS, accel_bias=0.3, rate_error=5e-4)
        log_ = drawn(FOLLOWER, drives, 600.0, seed, turning=0.15)
        graded = replace(drives, accel_bias=grade)
        found = smoother.smooth(epochs_of(log_.solution), FOLLOWER, graded)
        off.append(log_.accel_bias - found.accel_bias)
        sigmas.append(found.accel_bias_sigma)
    sigma = np.sqrt(np.mean(np.square(sigmas)))
    assert sigma < 0.12
    assert np.sqrt(np.mean(np.square(off))) < 1.5 * sigma


@pytest.mark.parametrize("gyro_bias", [0.003, 0.006])
def test_large_biases_of_accelerometers_beside_gyros_of_a_usual_bias(gyro_bias):
    """What the gyros' bias says of the accelerometers' takes nothing off the covariance of tilt."""
    for seed in range(3):
        drives = replace(SENSORS, accel_bias=0.3, rate_error=5e-4)
        log_ = drawn(VEHICLE, drives, 300.0, seed, turning=0.1)
        known = {"accel_bias": 0.03, "bias_removed": (gyro_bias, 0.0, 0.0)}
        found = smoother.smooth(epochs_of(log_.solution), VEHICLE, replace(drives, **known))
        alone = smoother.smooth(
            epochs_of(log_.solution), VEHICLE, replace(drives, accel_bias=0.03, bias_removed=None)
        )
        tilt = np.einsum("nii->ni", found.covariance_n)[:, :2]
        assert np.all(tilt > 0.999 * np.einsum("nii->ni", alone.covariance_n)[:, :2])
        assert found.accel_bias_sigma > 0.999 * alone.accel_bias_sigma


@pytest.mark.parametrize("likelihoods", [[-90, -80, -81, -99], [-90, -80] + 18 * [-81]])
def test_passes_that_lead_away_end_at_the_likeliest(likelihoods, monkeypatch):
    """It is as much less certain as its own step was long."""
    step, done = 0.2, []

    def scripted(epochs, motion, sensors, first, field, near, covariance):
        states = np.tile(first[0], (len(epochs) + 1, 1))
        tilted = exp([step * (len(done) + 1), 0.0, 0.0])
        states[:, :9] = to_dcm(tilted).ravel()
        done.append(tilted)
        covariance[:] = 1e-8
        return states, float(likelihoods[len(done) - 1])

    monkeypatch.setattr(smoother, "_pass", scripted)
    epochs = epochs_of(drawn(HAND, SENSORS, 4.0, 1).solution)
    found = smoother.smooth(epochs, HAND, SENSORS)
    assert len(done) == min(len(likelihoods), smoother.PASSES)
    assert np.allclose(found.q, done[1])
    assert found.covariance_n[:, 0, 0] == pytest.approx(step**2, rel=1e-3)
    assert not found.diverged


def test_of_an_attitude_whose_filter_diverges_nothing_is_known():
    """A force that no vehicle stands: neither the result nor its sigma pretends anything."""
    solution = drawn(VEHICLE, SENSORS, 20.0, 1).solution
    wild = replace(solution, specific_force_b=1e6 * solution.specific_force_b)
    found = smoother.smooth(epochs_of(wild), VEHICLE, SENSORS)
    assert found.diverged
    after = found.apply(wild)
    assert np.all(np.isfinite(after.q_nb))
    sigma = np.sqrt(np.einsum("nii->ni", after.covariance_attitude_n))
    assert np.all(sigma > np.radians(90.0))


def test_a_bias_by_which_the_first_attitude_was_levelled():
    """The filter says the same of both: the tilt is off by the bias, whichever it is."""
    biased = replace(SENSORS, accel_bias=0.05)
    log_ = drawn(VEHICLE, biased, 10.0, 3, turning=0.0)
    motion = replace(VEHICLE, finds_bias=True)
    epochs = epochs_of(log_.solution)
    _, p = first_state(epochs, motion, biased, 1e-3)
    body = epochs.values[0, JB : JB + 9].reshape(3, 3) / EPOCH_S
    shown = np.zeros((2, len(p)))
    shown[0, 1], shown[1, 0] = -GRAVITY, GRAVITY
    shown[:, 10:] = -body[:2]
    level = shown @ p @ shown.T
    assert np.sqrt(np.diag(level)) == pytest.approx(np.full(2, GRAVITY * 1e-3), rel=1e-2)
    assert np.sqrt(p[[0, 1], [0, 1]]) == pytest.approx(np.hypot(1e-3, 0.05 / GRAVITY), rel=1e-2)
