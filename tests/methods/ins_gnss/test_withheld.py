"""Errors of a solution at fixes that it was not given, where both are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.real_drives import solution as navigated
from sinstool.core.streams import GnssEpochs, Solution
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.ins_gnss.withheld import Withheld
from sinstool.simulation.gnss import GnssErrors
from tests.helpers.optimal_filter import radii
from tests.methods.ins_gnss.flown import Flown

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
ARM = (1.5, -0.7, -2.0)
TURN = Rotation.from_euler("ZYX", [2.0, 0.1, -0.2])
SIGMA = np.array([0.5, 0.8, 1.1])
OWN = np.array([0.2, 0.1, 0.4])


def line(time_ns):
    """A straight way across the date line: latitude, longitude and height."""
    t = (time_ns - START) * 1e-9
    longitude = np.pi - 4e-5 + 2e-6 * t
    return np.stack([0.8 - 1e-6 * t, (longitude + np.pi) % (2 * np.pi) - np.pi, 100 + 0.5 * t], 1)


def solution(time_ns):
    n = len(time_ns)
    q = np.tile(TURN.as_quat(scalar_first=True), (n, 1))
    zero = np.zeros((n, 3))
    covariance = np.tile(np.diag(SIGMA**2), (n, 1, 1))
    return Solution(time_ns, time_ns, q, zero, zero, line(time_ns),
                    covariance_position_n=covariance)  # fmt: skip


def fixes(time_ns, off):
    """Fixes of an antenna from which the solution is off by so many m, NED."""
    place = line(time_ns)
    away = TURN.apply(ARM) - off  # from the solution's IMU, m
    rm, rn = radii(place[:, 0])
    place[:, 1] += away[:, 1] / ((rn + place[:, 2]) * np.cos(place[:, 0]))
    place[:, 0] += away[:, 0] / (rm + place[:, 2])
    place[:, 2] -= away[:, 2]
    nothing = np.full((len(off), 3), np.nan)
    own = np.tile(OWN, (len(off), 1))
    return GnssEpochs(time_ns, time_ns, *place.T, nothing, own, nothing)


@pytest.mark.parametrize("block", [1, 7, 1000])
def test_errors_of_two_outages(block):
    times = START + np.arange(0, 40 * SECOND + 1, SECOND // 10)
    # the first fix is at the solution's first instant, the last at its last
    at = START + np.arange(0, 41) * SECOND
    at[1:-1] += 37_000_000
    off = np.random.default_rng(1).normal(0.0, [3.0, 2.0, 4.0], (len(at), 3))
    withheld = np.zeros(len(at), bool)
    withheld[:6] = withheld[20:25] = withheld[38:] = True
    scored = Withheld(fixes(at, off), withheld, ARM)
    for begin in range(0, len(times), block):
        scored.push(solution(times[begin : begin + block]))
    score = scored.score()
    sigma = np.hypot(SIGMA, OWN)
    spans = [slice(0, 6), slice(20, 25), slice(38, 41)]
    assert [one.epochs for one in score.outages] == [6, 5, 3]
    for one, part in zip(score.outages, spans, strict=True):
        horizontal = np.linalg.norm(off[part, :2], axis=1).max()
        assert one.start_ns == at[part][0]
        assert one.duration_s == pytest.approx((at[part][-1] - at[part][0]) * 1e-9)
        assert one.largest_horizontal_m == pytest.approx(horizontal, abs=1e-3)
        assert one.largest_vertical_m == pytest.approx(np.abs(off[part, 2]).max(), abs=1e-3)
        assert one.largest_in_sigmas == pytest.approx((np.abs(off[part]) / sigma).max(), rel=1e-3)
        assert one.rms_in_sigmas == pytest.approx(
            np.sqrt(np.mean((off[part] / sigma) ** 2)), rel=1e-3
        )
    largest = [one.largest_horizontal_m for one in score.outages]
    assert score.rms_of_largest_horizontal_m == pytest.approx(np.sqrt(np.mean(np.square(largest))))


def test_fixes_in_a_hole_of_the_imu_or_beyond_its_ends_do_not_count():
    times = START + np.arange(0, 20 * SECOND + 1, SECOND // 10)
    times = times[(times <= START + 8 * SECOND) | (times >= START + 11 * SECOND)]
    at = START + np.arange(-2, 24) * SECOND
    off = np.tile([1.0, 0.0, 0.0], (len(at), 1))
    off[(at < times[0]) | (at > times[-1])] = 50.0
    off[(at > START + 8 * SECOND) & (at < START + 11 * SECOND)] = 50.0
    scored = Withheld(fixes(at, off), np.ones(len(at), bool), ARM)
    scored.push(solution(times))
    (one,) = scored.score().outages
    assert one.largest_horizontal_m == pytest.approx(1.0, abs=1e-3)


def test_fixes_that_nothing_reaches_give_no_score():
    at = START + np.arange(5) * SECOND
    scored = Withheld(fixes(at, np.zeros((5, 3))), np.ones(5, bool), ARM)
    assert scored.score() is None
    scored.push(solution(at[-1:] + np.arange(1, 4) * SECOND))
    assert scored.score() is None


def test_errors_over_sigma_where_fixes_wander():
    # Solution and fix share what varies slowly; the receiver states ten times its white noise
    white, slow, tau = (0.3, 0.3, 0.5), (2.0, 2.0, 3.0), 60.0
    errors = GnssErrors(white, slow, tau, (0.05, 0.05, 0.08))
    model = GnssModel(white, slow, tau, (0.05, 0.05, 0.08), (1e-3,) * 3)
    squares = {"filter": [], "smoother": [], "stated": []}
    for seed in range(24):
        flown = Flown(seed, errors=errors)
        stated = np.full((len(flown.gnss), 3), 3.0)
        t = (flown.gnss.time_ns - flown.gnss.time_ns[0]) * 1e-9
        withheld = ((t > 60.0) & (t < 75.0)) | ((t > 120.0) & (t < 135.0))
        run, blocks = flown.run(
            flown.using("markov-21", gnss=model), withheld=withheld, store=True, with_baro=False
        )
        received = replace(flown.gnss, sigma_position_n=stated)
        scores = {name: Withheld(received, withheld, (0.0,) * 3) for name in squares}
        with Smoother(run.kind) as smoother:
            for block in blocks:
                scores["filter"].push(navigated(block.updates))
                scores["filter"].filtered(block.gnss)
                smoother.push(block)
            epochs = smoother.epochs()
            for block in blocks:
                scores["smoother"].smoothed(block.gnss, epochs)
            for updates in smoother.blocks(epochs):
                scores["smoother"].push(navigated(updates))
                scores["stated"].push(navigated(updates))
        for name, scored in scores.items():
            squares[name] += [one.rms_in_sigmas**2 for one in scored.score().outages]
    found = {name: np.sqrt(np.mean(values)) for name, values in squares.items()}
    assert found["filter"] == pytest.approx(1.0, abs=0.08)
    assert found["smoother"] == pytest.approx(1.0, abs=0.08)
    assert found["stated"] < 0.6
