"""Samples that are no measurements are found, and nothing else is."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.streams import Imu, concatenate
from sinstool.io.readers import open_log
from sinstool.survey.no_measurements import Suspects
from sinstool.survey.source import imu_blocks, prepare
from sinstool.survey.stuck_axes import AXES
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import GRADES, drive, record, write

RATE = 100.0
SEEDS = range(5)


def motion(seed, n=6000, noise=1.0, rest=(0.0, 10.0)):
    """Rates and forces, shape (n, 6): slow ones, with a rest, and the noise of a MEMS sensor."""
    random = np.random.default_rng(seed)
    t = np.arange(n) / RATE
    rows = np.stack([a * np.sin(w * t + p) for a, w, p in zip(
        random.uniform(0.1, 0.5, 6), random.uniform(0.3, 2.0, 6), random.uniform(0.0, 6.0, 6),
        strict=True)], axis=1)  # fmt: skip
    rows *= np.clip(np.where(t < rest[1], rest[0] - t, t - rest[1]), 0.0, 1.0)[:, None]
    rows += noise * np.repeat([2e-3, 2e-2], 3) * random.standard_normal((n, 6))
    rows[:, 5] -= 9.8
    return rows


def imu(rows, rate=RATE):
    times = T0 + np.round(np.arange(len(rows)) / rate * 1e9).astype(np.int64)
    return Imu(times, times, rows[:, :3].copy(), rows[:, 3:].copy(), None)


def found(rows, cuts=(), rate=RATE):
    """Rows that are left out."""
    whole, suspects = imu(rows, rate), Suspects()
    edges = [0, *cuts, len(rows)]
    blocks = [whole.rows(np.arange(a, b)) for a, b in pairwise(edges)]
    for _ in suspects.watch(iter(blocks)):
        pass
    out = suspects.found()
    if out is None:
        return [], 0, 0
    kept = concatenate(list(out.applied(iter([whole]))))
    return np.flatnonzero(~np.isin(whole.time_ns, kept.time_ns)).tolist(), out.hung, out.wrong


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("cuts", [(), (3003,), tuple(range(50, 6000, 50)), (3001, 3002, 3003)])
def test_what_a_sensor_that_hangs_repeats_is_none(seed, cuts):
    rows = motion(seed)
    rows[3000:3200] = rows[3000]
    assert found(rows, cuts) == (list(range(3001, 3200)), 199, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_zeros_are_none(seed):
    rows = motion(seed)
    rows[[70, 400]] = 0.0
    rows[3000:3200] = 0.0
    assert found(rows) == ([70, 400, *range(3000, 3200)], 202, 0)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("cuts", [(), (2000, 2001, 2002, 2010, 4001), tuple(range(50, 6000, 50))])
def test_single_values_that_leap_are_none(seed, cuts):
    rows, random = motion(seed), np.random.default_rng(seed)
    at = np.sort(random.choice(np.arange(20, 5980, 20), 30, replace=False))
    axis = random.integers(0, 6, 30)
    rows[at, axis] = np.where(axis < 3, 34.9, 156.9) * random.choice([-1.0, 1.0], 30)
    rows[at[:5], (axis[:5] + 3) % 6] = 30.0  # of a rate and a force together
    assert found(rows, cuts) == (at.tolist(), 0, 30)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_what_moves_is_measured(seed, scale):
    """A blow shakes all axes, also for one sample only; and a turn that begins in one sample."""
    rows, random = motion(seed), np.random.default_rng(seed)
    for at in (1500, 2500):
        rows[at, 3:] += scale * random.uniform(0.5, 1.0, 3)
        rows[at, :3] += 0.01 * scale * random.uniform(0.5, 1.0, 3)
    for k in range(30):  # which rings
        rows[3500 + k] += (
            scale * random.standard_normal(6) * np.exp(-k / 4.0) * [0.1, 0.1, 0.1, 1, 1, 1]
        )
    rows[4500:4700, 2] += scale * 0.05
    assert found(rows) == ([], 0, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_alike_without_noise_is_measured(seed):
    """A simulation rests exactly, and a coarse sensor too; a driver may send each value thrice."""
    assert found(motion(seed, noise=0.0)) == ([], 0, 0)
    assert found(motion(seed, noise=0.0, rest=(30.0, 40.0))) == ([], 0, 0)
    step = np.repeat([0.02, 0.2], 3)
    coarse = np.round(motion(seed, rest=(30.0, 40.0)) / step) * step
    assert found(coarse) == ([], 0, 0)
    assert found(np.repeat(motion(seed), 3, axis=0), rate=3 * RATE) == ([], 0, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_counts_in_rates_made_of_angles_are_measured(seed):
    """Differences of counted angles repeat but for their rounding, and now and then by a count."""
    random = np.random.default_rng(seed)
    count = np.repeat([5e-6, 1e-4], 3)
    turned = np.cumsum(np.tile([12.0, -7.0, 3.0, 10.0, 20.0, -981.0], (6000, 1)), axis=0)
    turned += np.cumsum(0.02 * random.standard_normal((6000, 6)), axis=0)
    rows = np.diff(0.7 + count * np.floor(turned), axis=0, prepend=0.7) * RATE
    assert found(rows[1:]) == ([], 0, 0)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("cuts", [(), (3003,), tuple(range(50, 6000, 50))])
def test_a_single_axis_that_hangs_is_no_measurement(seed, cuts):
    """Up to the end of the log, too; whatever it reads, and whether or not it leaps afterwards."""
    rows = motion(seed)
    axis = seed % 6
    rows[3000:3200, axis] = rows[3000, axis]
    rows[5700:, (axis + 2) % 6] = 0.01
    left_out = [*range(3001, 3200), *range(5701, 6000)]
    kept = found(rows, cuts)[0]
    # What happens to differ by nothing at the ends belongs to it
    assert sorted(set(kept) ^ set(left_out)) in ([], [3000], [5700])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("own", [slice(0, 3), slice(3, 6)], ids=["gyros", "accelerometers"])
def test_a_whole_sensor_that_hangs_beside_another_is_no_measurement(seed, own):
    rows = motion(seed)
    rows[3000:3200, own] = rows[3000, own]
    assert found(rows, (3100,)) == (list(range(3001, 3200)), 0, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_coarse_gyros_rest_while_accelerometers_show_noise(seed):
    rows = motion(seed, rest=(20.0, 40.0))
    rows[:, :3] = np.round(rows[:, :3] / 0.02) * 0.02
    rows[4000:, :3] += [0.1, -0.1, 0.06]
    assert found(rows) == ([], 0, 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_axis_that_repeats_its_value_by_right_is_measured(seed):
    """At the end of its range; at rest where rounding is coarser than noise; by a slow driver."""
    rows = motion(seed)
    rows[3000:3200, 2] = 0.6
    assert found(rows)[0] == []
    random = np.random.default_rng(seed)
    for rounded in (0.5, 1.0, 2.0, 4.0):
        step = rounded * np.repeat([2e-3, 2e-2], 3)
        rows = motion(seed, rest=(20.0, 30.0))
        rows[2000:3000] = rows[2000] + 0.25 * (rows[2000:3000] - rows[2000:3000].mean(axis=0))
        shaken = rows + random.standard_normal(rows.shape) * np.linspace(0.0, 4.0, 6) * step
        assert found(np.round(rows / step) * step)[0] == []
        assert found(np.round(shaken / step) * step)[0] == []


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [1.0, 0.0])
def test_an_axis_without_noise_is_dead_where_the_others_have_some(seed, noise):
    """What is simulated without noise, in a plane, has axes that never change by right."""
    rows = motion(seed, noise=noise)
    rows[:, seed % 6] = 0.0
    suspects, whole = Suspects(), imu(rows)
    for _ in suspects.watch(iter([whole.rows(np.arange(3000)), whole.rows(np.arange(3000, 6000))])):
        pass
    assert suspects.dead() == ((AXES[seed % 6],) if noise else ())


def test_data_of_zeros_or_without_gravity_are_not_judged():
    rows = motion(1)
    rows[:4000] = 0.0
    assert found(rows) == ([], 0, 0)
    rows = motion(1)
    rows[:, 5] += 9.8
    rows[:, 3:] *= 0.1
    assert found(rows) == ([], 0, 0)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_log_is_as_if_they_had_not_been_recorded(tmp_path, seed):
    data = record(drive(seed, 120.0, 30.0), GRADES["industrial"], seed)
    gyro, accel = data.gyro.copy(), data.accel.copy()
    t = data.seconds
    hung, zero = (t > 60.0) & (t < 62.0), (t > 80.0) & (t < 81.0)
    gyro[hung], accel[hung] = gyro[hung][0], accel[hung][0]
    gyro[zero], accel[zero] = 0.0, 0.0
    gyro[[2500, 9000], [0, 2]] = 30.0 / 200.0
    with open_log(write(tmp_path / "log.mcap", replace(data, gyro=gyro, accel=accel))) as log:
        source = prepare(log, ProcessConfig())
        kept = concatenate(list(imu_blocks(source, source.survey.first_ns)))
        # Another reading of the file tells the same
        source.samples.blocks = None
        again = concatenate(list(imu_blocks(source, source.survey.first_ns)))
    kinds = {finding.kind: finding for finding in source.findings}
    count = int(hung.sum()) - 1 + int(zero.sum())
    assert kinds["imu-hangs"].numbers == {"samples": count}
    assert kinds["wrong-values"].numbers == {"samples": 2}
    assert source.survey.count == len(kept) == len(t) - count - 2
    assert [round(seconds) for _, seconds in source.survey.gaps] == [2, 1]
    np.testing.assert_array_equal(kept.gyro, again.gyro)
