"""The smoother against least squares over all times at once, and by its consistency."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import earth
from sinstool.core.rotation import conjugate, exp, log, multiply
from sinstool.methods.ins_gnss import smoothed_epochs as epochs_module
from sinstool.methods.ins_gnss.layout import SENSORS
from sinstool.methods.ins_gnss.results import FilterBlock, StoredEpochs, UpdateColumns
from sinstool.methods.ins_gnss.rts import CORNER, pack
from sinstool.methods.ins_gnss.settings import DivergenceControl
from sinstool.methods.ins_gnss.smoothed_epochs import OF_ROWS, smooth_columns
from sinstool.methods.ins_gnss.smoother import COVARIANCES, Smoother, smooth_updates
from sinstool.methods.ins_gnss.states import FILTERS, GYRO_BIAS, I_MOVING
from sinstool.methods.strapdown.navigation import SIZE
from sinstool.simulation.gnss import GnssFaults
from tests.methods.ins_gnss.flown import Flown

KIND = FILTERS["plain-15"]
N = KIND.size
MOVING = int(KIND.index[I_MOVING])
LAT, LON, H = 0.7, -1.2, 450.0


class Problem:
    """A linear system with random dynamics, states of very different sizes, and measurements."""

    def __init__(self, seed, rows=12, measured=6, size=None):
        random = np.random.default_rng(seed)
        self.size = 10.0 ** random.uniform(-5, 2, N) if size is None else np.full(N, size)
        d = np.diag(self.size)
        e = np.diag(1.0 / self.size)
        change = 0.2 * random.standard_normal((rows, N, N))
        # States that do not move only decay, each by itself
        change[:, MOVING:] *= np.eye(N)[MOVING:]
        self.phi = [d @ (np.eye(N) + one) @ e for one in change]
        noise = [0.3 * random.standard_normal((N, 4)) for _ in range(rows)]
        self.q = [d @ (w @ w.T) @ d for w in noise]  # singular, as that of a filter
        self.h = [random.standard_normal((measured, N)) @ e for _ in range(rows)]
        self.r = [np.diag(random.uniform(0.1, 1.0, measured)) for _ in range(rows)]
        root = d @ random.standard_normal((N, N))
        self.p0 = root @ root.T
        # The truth, as the error that the uncorrected navigation has
        x = root @ random.standard_normal(N)
        self.truth, self.z = [], []
        for k in range(rows):
            x = self.phi[k] @ x + d @ noise[k] @ random.standard_normal(4)
            self.truth.append(x)
            v = np.sqrt(np.diag(self.r[k])) * random.standard_normal(measured)
            self.z.append(self.h[k] @ x + v)
        self.rows = rows

    def closed_loop(self, restart=()):
        """What a filter with feedback stores, and what it has taken out in total."""
        p, out, total = self.p0, [], np.zeros(N)
        totals = []
        for k in range(self.rows):
            before = self.phi[k] @ p @ self.phi[k].T + self.q[k]
            total = self.phi[k] @ total
            if k in restart:
                before = self.p0
            s = self.h[k] @ before @ self.h[k].T + self.r[k]
            gain = np.linalg.solve(s, self.h[k] @ before).T
            correction = gain @ (self.z[k] - self.h[k] @ total)
            p = before - gain @ s @ gain.T
            p = 0.5 * (p + p.T)
            total = total + correction
            totals.append(total)
            out.append((self.phi[k], before, p, correction, k in restart))
        phi, before, after, correction, restarts = map(np.array, zip(*out, strict=True))
        stored = StoredEpochs(
            np.arange(1, self.rows + 1, dtype=np.int64) * 10**9,
            np.arange(self.rows) * 10 + 9,
            phi,
            before,
            after,
            correction,
            np.zeros((self.rows, N)),
            np.tile(np.r_[LAT, LON, H, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (self.rows, 1)),
            np.zeros((self.rows, SENSORS)),
            restarts,
        )
        return stored, np.array(totals)

    def least_squares(self, first=0, last=None):
        """All states at once: start, dynamics and measurements as one set of equations."""
        last = self.rows if last is None else last
        rows = last - first
        information = np.zeros((N * (rows + 1), N * (rows + 1)))
        right = np.zeros(N * (rows + 1))
        scale = np.tile(self.size, rows + 1)

        def add(j, covariance, value):
            # in states divided by their sizes, so that the normal equations are sound
            j = j * scale
            weight = np.linalg.inv(covariance)
            information[:] += j.T @ weight @ j
            right[:] += j.T @ weight @ value

        e = np.diag(1.0 / self.size)
        whole = np.eye(N * (rows + 1))
        block = [whole[N * k : N * (k + 1)] for k in range(rows + 1)]
        start = e @ self.p0 @ e
        add(e @ block[0], start, np.zeros(N))
        for k in range(rows):
            q = e @ self.q[first + k] @ e
            # A little noise in the directions that have none makes the weights finite.
            move = e @ (block[k + 1] - self.phi[first + k] @ block[k])
            add(move, q + 1e-9 * np.eye(N), np.zeros(N))
            add(self.h[first + k] @ block[k + 1], self.r[first + k], self.z[first + k])
        covariance = np.linalg.inv(information)
        x = (covariance @ right) * scale
        covariance = scale[:, None] * covariance * scale
        return (
            x.reshape(rows + 1, N)[1:],
            np.array([covariance[N * k :][:N, N * k :][:, :N] for k in range(1, rows + 1)]),
        )


def smooth_epochs(stored, kind, start_ns=None):
    """A whole run smoothed, with the covariances of all states."""
    columns = {name: np.array(getattr(stored, name)) for name in OF_ROWS}
    whole = np.empty((len(stored), kind.size, kind.size))
    return smooth_columns(columns, pack(stored, kind), kind, start_ns, whole=whole)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_is_least_squares_over_all_times(seed):
    problem = Problem(seed)
    problem.q = [q + 1e-9 * np.diag(problem.size**2) for q in problem.q]
    stored, total = problem.closed_loop()
    smoothed = smooth_epochs(stored, KIND)
    result = total + smoothed.error
    problem.q = [q - 1e-9 * np.diag(problem.size**2) for q in problem.q]
    expected, covariance = problem.least_squares()
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(result / sigma, expected / sigma, atol=2e-4)
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(smoothed.covariance / scale, covariance / scale, atol=2e-4)
    # and that is another answer than the filter's
    assert np.abs((total - expected) / sigma)[:-1].max() > 1.0


def test_its_errors_are_of_the_size_that_it_says():
    nees = []
    for seed in range(60):
        problem = Problem(seed + 100, rows=8)
        stored, total = problem.closed_loop()
        smoothed = smooth_epochs(stored, KIND)
        error = (total + smoothed.error - problem.truth) / problem.size
        covariance = smoothed.covariance / np.outer(problem.size, problem.size)
        nees.append([e @ np.linalg.solve(p, e) for e, p in zip(error, covariance, strict=True)])
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    # 60 x 15 degrees of freedom at each row: sigma 0.047
    np.testing.assert_allclose(np.mean(nees, axis=0) / N, 1.0, atol=0.16)


def test_nothing_crosses_a_restart():
    problem = Problem(5)
    stored, _ = problem.closed_loop(restart=(7,))
    smoothed = smooth_epochs(stored, KIND)
    alone = smooth_epochs(StoredEpochs(**{k: v[:7] for k, v in vars(stored).items()}), KIND)
    np.testing.assert_array_equal(smoothed.error[:7], alone.error)
    np.testing.assert_array_equal(smoothed.error[6], 0.0)
    np.testing.assert_array_equal(smoothed.error_before[7], 0.0)
    np.testing.assert_array_equal(smoothed.covariance[6], stored.covariance_after[6])
    assert np.abs(smoothed.error[5]).max() > 0.0
    assert np.abs(smoothed.error[8]).max() > 0.0


def test_states_without_variance_and_copies_do_no_harm():
    problem = Problem(6)
    for k in range(problem.rows):
        # 14 is known exactly; 13 is 12 times a factor
        problem.phi[k][14], problem.phi[k][:, 14] = 0.0, 0.0
        problem.phi[k][14, 14] = 1.0
        problem.phi[k][13, 13] = problem.phi[k][12, 12]
        problem.q[k][14], problem.q[k][:, 14] = 0.0, 0.0
    problem.p0[14], problem.p0[:, 14] = 0.0, 0.0
    problem.p0[13] = 2.0 * problem.p0[12]
    problem.p0[:, 13] = 2.0 * problem.p0[:, 12]
    for k in range(problem.rows):
        problem.q[k][13] = 2.0 * problem.q[k][12]
        problem.q[k][:, 13] = 2.0 * problem.q[k][:, 12]
    stored, _ = problem.closed_loop()
    smoothed = smooth_epochs(stored, KIND)
    assert np.all(np.isfinite(smoothed.error))
    np.testing.assert_allclose(smoothed.error[:-1, 14], 0.0, atol=1e-12)
    # the copy is smoothed as what it copies
    np.testing.assert_allclose(
        smoothed.error[:-1, 13], 2.0 * smoothed.error[:-1, 12], rtol=1e-5, atol=1e-9
    )


def updates(stored, per_row=10):
    """Outputs of a vehicle at rest, ten between two rows."""
    m = len(stored) * per_row
    zero, eye = np.zeros((m, 3)), np.tile(np.eye(3), (m, 1, 1))
    tip = np.tile(exp(np.array([0.3, -0.2, 2.0])), (m, 1))
    return UpdateColumns(
        (np.arange(m) + 1) * 10**9 // per_row,
        np.full(m, LAT),
        np.full(m, LON),
        np.full(m, H),
        zero,
        tip,
        zero,
        zero,
        np.zeros(m),
        eye,
        eye,
        eye,
    )


def small_problem(**more):
    """Errors small enough to be those of a navigation."""
    return Problem(8, size=1e-2).closed_loop(**more)


def metres(columns):
    meridian, transverse = earth.radii_of_curvature(LAT)
    return np.stack(
        [
            (columns.latitude - LAT) * (meridian + H),
            (columns.longitude - LON) * (transverse + H) * np.cos(LAT),
            H - columns.height,
        ],
        axis=1,
    )


def test_between_rows_the_outputs_have_no_steps_of_their_own():
    stored, _ = small_problem()
    smoothed = smooth_epochs(stored, KIND)
    columns = smooth_updates(updates(stored), 0, smoothed)
    rows = np.arange(9, len(columns), 10)
    # at a row: the filter's answer after it, less d
    np.testing.assert_allclose(metres(columns)[rows], -smoothed.error[:, :3], rtol=1e-6, atol=2e-9)
    np.testing.assert_allclose(columns.velocity_n[rows], -smoothed.error[:, 3:6], atol=1e-15)
    turned = log(multiply(columns.q_nb, conjugate(updates(stored).q_nb)))
    np.testing.assert_allclose(turned[rows], smoothed.error[:, 6:9], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(columns.omega_ib_b[rows], -smoothed.error[:, 9:12], atol=1e-15)
    assert KIND.first(GYRO_BIAS) == 9
    # just before a row: less d + dx
    before = smoothed.error_before[1:]
    linear = smoothed.error[:-1] + 0.9 * (before - smoothed.error[:-1])
    np.testing.assert_allclose(columns.velocity_n[rows[1:] - 1], -linear[:, 3:6], atol=1e-15)
    # the slope of position is that of velocity at both ends of a span
    p = metres(columns)[19:29]
    slope = np.polynomial.polynomial.polyfit(0.1 * np.arange(10), p, 3)[1]
    np.testing.assert_allclose(slope, columns.velocity_n[19], rtol=1e-4, atol=1e-6)


def test_before_a_restart_and_after_the_last_row_the_filter_is_left_alone():
    stored, _ = small_problem(restart=(7,))
    smoothed = smooth_epochs(stored, KIND)
    own = updates(stored)
    columns = smooth_updates(own, 0, smoothed)
    alone = slice(10 * 6 + 9, 10 * 7 + 9)
    np.testing.assert_array_equal(columns.velocity_n[alone], own.velocity_n[alone])
    np.testing.assert_array_equal(columns.height[alone], own.height[alone])
    np.testing.assert_array_equal(columns.covariance_velocity_n[alone][0], np.eye(3))
    np.testing.assert_array_equal(columns.velocity_n[-1], own.velocity_n[-1])
    assert np.abs(columns.velocity_n[10 * 7 + 9]).max() > 0.0
    assert np.abs(columns.velocity_n[10 * 6 + 8]).max() > 0.0


@pytest.mark.parametrize("limit", [0, 10**9])
@pytest.mark.parametrize("rows", [1, 7, 4096])
@pytest.mark.parametrize("at_once", [1, 8 * 400 * 5, 10**9])
def test_blocks_and_files_change_nothing(limit, rows, at_once, monkeypatch):
    stored, _ = small_problem(restart=(4,))
    own = updates(stored)
    # each its own, so that one in another's place would be seen
    each = (1.0 + np.arange(len(own)))[:, None, None]
    own = replace(own, **{n: each * getattr(own, n) for n in COVARIANCES})
    epochs = smooth_epochs(stored, KIND, int(own.time_ns[0]))
    whole = smooth_updates(own, 0, epochs)
    monkeypatch.setattr(epochs_module, "AT_ONCE", at_once)
    with Smoother(KIND, limit) as smoother:
        for k in range(len(stored)):
            part = {n: v[10 * k : 10 * k + 10] for n, v in vars(own).items()}
            row = {n: v[k : k + 1].copy() for n, v in vars(stored).items()}
            smoother.push(FilterBlock(UpdateColumns(**part), None, StoredEpochs(**row)))
        smoothed = smoother.epochs()
        assert bool(smoother._storage._files) == (limit == 0)
        for name in ("error", "error_before", "first_covariance"):
            np.testing.assert_array_equal(getattr(smoothed, name), getattr(epochs, name))
        np.testing.assert_array_equal(smoothed.covariance, epochs.covariance[:, :CORNER, :CORNER])
        few = np.array([3, 4, 8])
        np.testing.assert_array_equal(
            smoother.covariance(smoothed, few), epochs.covariance[:, few[:, None], few]
        )
        result = list(smoother.blocks(smoothed, rows))
    for name, expected in vars(whole).items():
        np.testing.assert_array_equal(np.concatenate([getattr(b, name) for b in result]), expected)


def test_what_cannot_be_smoothed_is_refused():
    stored, _ = small_problem()
    with Smoother(KIND) as smoother, pytest.raises(ValueError, match="nothing to smooth"):
        smoother.epochs()
    with pytest.raises(ValueError, match="states"):
        smooth_epochs(stored, FILTERS["markov-21"])
    with Smoother(KIND) as smoother, pytest.raises(ValueError, match="outputs"):
        smoother.push(FilterBlock(None, None, stored))
    assert stored.nav.shape[1] == SIZE


OUTAGE = (90.0, 120.0)


def smoothed_flight(seed, name):
    """A flight with an outage: truth, filter and smoother at every IMU update."""
    flown = Flown(seed=seed, faults=GnssFaults(outages=(OUTAGE,)), offset_s=0.0)
    settings = flown.using(name, control=DivergenceControl(virtual_noise=False))
    run, blocks = flown.run(settings, store=True)
    with Smoother(run.kind) as smoother:
        for block in blocks:
            smoother.push(block)
        epochs = smoother.epochs()
        result = list(smoother.blocks(epochs))
    joined = {n: np.concatenate([getattr(b, n) for b in result]) for n in vars(result[0])}
    own = {n: np.concatenate([getattr(b.updates, n) for b in blocks]) for n in joined}
    return flown.flight, UpdateColumns(**own), UpdateColumns(**joined), epochs


def off_truth(flight, columns):
    """Errors of position and velocity, NED, and psi."""
    rows = np.searchsorted(flight.time_ns, columns.time_ns)
    meridian, transverse = earth.radii_of_curvature(flight.latitude[rows])
    h, lat = flight.height[rows], flight.latitude[rows]
    east = np.mod(columns.longitude - flight.longitude[rows] + np.pi, 2.0 * np.pi) - np.pi
    return np.column_stack(
        [
            (columns.latitude - lat) * (meridian + h),
            east * (transverse + h) * np.cos(lat),
            h - columns.height,
            columns.velocity_n - flight.velocity_n[rows],
            log(multiply(flight.imu.q_nb[rows], conjugate(columns.q_nb))),
        ]
    )


@pytest.mark.parametrize("name", ["markov-21", "network-26a"])
def test_a_flight_is_known_better_afterwards_and_by_as_much_as_it_says(name):
    filtered, smooth, nees = [], [], []
    for seed in range(1, 6):
        flight, own, columns, epochs = smoothed_flight(seed, name)
        before, after = off_truth(flight, own), off_truth(flight, columns)
        t = (columns.time_ns - flight.time_ns[0]) * 1e-9
        gap = (t > OUTAGE[0] + 1.0) & (t < OUTAGE[1])
        filtered.append(np.sqrt(np.mean(before[gap] ** 2, axis=0)))
        smooth.append(np.sqrt(np.mean(after[gap] ** 2, axis=0)))
        # between the rows as well as at them
        for first, covariance in (
            (0, columns.covariance_position_n),
            (3, columns.covariance_velocity_n),
            (6, columns.covariance_attitude_n),
        ):
            e = after[200::37, first : first + 3]
            x = np.linalg.solve(covariance[200::37], e[:, :, None])[:, :, 0]
            nees.append((first, np.mean(np.sum(e * x, axis=1)) / 3.0))
        # rows in the outage too, so that no interpolation spans it
        rows = (epochs.time_ns - flight.time_ns[0]) * 1e-9
        assert np.diff(rows).max() < 2.0
        # nothing but the flight's own motion between two updates: no step at any epoch
        moved = np.diff(after[:, :3], axis=0)
        assert np.abs(moved[t[1:] < 199.0]).max() < 0.05
    before, after = np.mean(filtered, axis=0), np.mean(smooth, axis=0)
    assert np.all(after[:2] < 0.5 * before[:2])
    assert np.all(after[3:5] < 0.6 * before[3:5])
    assert np.all(after[6:8] < 0.6 * before[6:8])
    assert after[8] < 1.3 * before[8]
    for first in (0, 3, 6):
        assert 0.5 < np.mean([v for f, v in nees if f == first]) < 1.6, nees
