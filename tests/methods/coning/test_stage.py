import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.coning.algorithm import MultiSampleAlgorithm
from sinstool.methods.coning.increments import GYRO_KINDS, RateIntegrator
from sinstool.methods.coning.registry import algorithm, names
from sinstool.methods.coning.stage import ConingStage
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.truth import sample_times

NOMINAL = 0.005


class LookAhead(MultiSampleAlgorithm):
    """Weighted neighbours on both sides; only for what the stage must get right."""

    summary = source = "test"

    def __init__(self, size, before, after, takes="increments"):
        self.name = "look-ahead"
        self.takes = takes
        self.samples, self.before, self.after = size, before, after

    def _fill(self, x, dt, first, out):
        for update in range(len(out)):
            start = first + update * self.samples
            rows = range(
                max(start - self.before, 0), min(start + self.samples + self.after, len(x))
            )
            # which rows there are and which duration they have must both matter
            out[update] = sum(x[r] * (2.0 + r - start) * dt[start] for r in rows) / len(rows)

    def _of_samples(self, samples):
        return LookAhead(samples, self.before + 1, self.after, self.takes)


ALGORITHMS = {name: algorithm(name) for name in (*names(), "savage-two-speed-7")}
ALGORITHMS |= {
    "fixed beta": algorithm("singular-perturbation", epsilon=1e-3, beta=(1.0, 2.0, 3.0)),
    "look-ahead 1": LookAhead(1, 2, 3),
    "look-ahead 3": LookAhead(3, 0, 4),
    "look-ahead rates": LookAhead(2, 1, 2, "rates"),
}


def log(count, seed=0):
    rng = np.random.default_rng(seed)
    steps = rng.integers(4_900_000, 5_100_000, size=count)
    time_ns = 1_600_000_000_000_000_000 + np.cumsum(steps)
    return rng.normal(size=(count, 3)), time_ns


def run(chosen, kind, gyro, time_ns, block, **options):
    stage = ConingStage(chosen, kind, nominal_interval=NOMINAL, **options)
    parts = [
        stage.push(gyro[i : i + block], time_ns[i : i + block])
        for i in range(0, len(time_ns), block)
    ]
    parts.append(stage.finish())
    return tuple(
        np.concatenate([getattr(part, field) for part in parts])
        for field in ("sample", "time_ns", "interval", "rotation_vector")
    )


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 9, 14, 101])
@pytest.mark.parametrize("kind", GYRO_KINDS)
@pytest.mark.parametrize("label", ALGORITHMS)
def test_blocks_do_not_matter(label, kind, count):
    chosen = ALGORITHMS[label]
    gyro, time_ns = log(count)
    whole = run(chosen, kind, gyro, time_ns, max(count, 1))
    for block in (1, 7, 4096):
        for ours, theirs in zip(run(chosen, kind, gyro, time_ns, block), whole, strict=True):
            np.testing.assert_array_equal(ours, theirs)

    # Every interval is answered for once: full updates, then one of what is left.
    sample, stamps, interval, phi = whole
    size = chosen.samples
    full, left = divmod(count - 1, size)
    ends = [size * k for k in range(1, full + 1)] + ([count - 1] if left else [])
    np.testing.assert_array_equal(sample, ends)
    np.testing.assert_array_equal(stamps, time_ns[sample])
    np.testing.assert_array_equal(interval, np.diff(time_ns[[0, *ends]]) * 1e-9)
    assert phi.shape == (len(ends), 3)
    assert np.all(np.isfinite(phi))
    assert sample.dtype == stamps.dtype == np.int64


@pytest.mark.parametrize("points", [2, 4, 8])
def test_blocks_do_not_matter_for_any_interpolation(points):
    for count in (2, 3, 5, 9, 40):
        gyro, time_ns = log(count)
        whole = run(ALGORITHMS["optimal-3"], "rate", gyro, time_ns, count, points=points)
        for block in (1, 7):
            parts = run(ALGORITHMS["optimal-3"], "rate", gyro, time_ns, block, points=points)
            np.testing.assert_array_equal(parts[3], whole[3])


def test_random_blocks_with_empty_ones():
    rng = np.random.default_rng(11)
    gyro, time_ns = log(300)
    whole = run(ALGORITHMS["look-ahead 3"], "rate", gyro, time_ns, 300)
    for _ in range(5):
        stage = ConingStage(ALGORITHMS["look-ahead 3"], "rate")
        edges = np.sort(rng.integers(0, 301, size=60))
        blocks = np.split(np.arange(300), edges)
        parts = [stage.push(gyro[b], time_ns[b]) for b in blocks]
        parts.append(stage.finish())
        phi = np.concatenate([p.rotation_vector for p in parts])
        np.testing.assert_array_equal(phi, whole[3])


@pytest.mark.parametrize("kind", ["mean-rate", "increment"])
def test_first_increment_is_history_only(kind):
    gyro, time_ns = log(10)
    dt = np.concatenate([[NOMINAL], np.diff(time_ns) * 1e-9])
    increments = gyro if kind == "increment" else gyro * dt[:, None]
    phi = run(ALGORITHMS["previous-2"], kind, gyro, time_ns, 4)[3]
    expected = ALGORITHMS["previous-2"].rotation_vectors(increments, dt, 1, 9)
    np.testing.assert_array_equal(phi, expected)
    # with its nominal interval where it has to become a rate, or from one
    rates = gyro / dt[:, None] if kind == "increment" else gyro
    phi = run(ALGORITHMS["singular-perturbation"], kind, gyro, time_ns, 4)[3]
    expected = ALGORITHMS["singular-perturbation"].rotation_vectors(rates, dt, 1, 9)
    np.testing.assert_array_equal(phi, expected)


def test_point_rates_have_no_history_before_their_first_instant():
    gyro, time_ns = log(20)
    dt = np.concatenate([[np.nan], np.diff(time_ns) * 1e-9])
    increments = RateIntegrator(6).increments(gyro, dt, 1, 19)
    phi = run(ALGORITHMS["previous-3"], "rate", gyro, time_ns, 6)[3]
    expected = ALGORITHMS["previous-3"].rotation_vectors(increments, dt[1:], 0, 19)
    np.testing.assert_array_equal(phi, expected)
    phi = run(ALGORITHMS["singular-perturbation"], "rate", gyro, time_ns, 6)[3]
    expected = ALGORITHMS["singular-perturbation"].rotation_vectors(gyro, dt, 1, 19)
    np.testing.assert_array_equal(phi, expected)


def test_what_is_left_at_the_end_gets_a_shorter_update():
    gyro, time_ns = log(12)
    phi = run(ALGORITHMS["optimal-4"], "increment", gyro, time_ns, 5)[3]
    dt = np.full(12, np.nan)
    full = ALGORITHMS["optimal-4"].rotation_vectors(gyro, dt, 1, 2)
    tail = ALGORITHMS["optimal-4"].shorter(3).rotation_vectors(gyro, dt, 9, 1)
    np.testing.assert_array_equal(phi, np.concatenate([full, tail]))


@pytest.mark.parametrize("name", ["previous-3", "optimal-4", "optimal-6", "savage-two-speed"])
@pytest.mark.parametrize("kind", GYRO_KINDS)
def test_attitude_at_the_end_of_a_segment(name, kind):
    # 402 intervals: not a multiple of 4; the ends must be as good as the middle
    motion = classical_coning(sample_times(400.0, 402 / 400.0), np.deg2rad(1.0), 5.0)
    gyro = {
        "rate": motion.gyro_rate,
        "mean-rate": motion.gyro_mean_rate,
        "increment": motion.gyro_increment,
    }[kind]
    stage = ConingStage(algorithm(name), kind, nominal_interval=1 / 400.0)
    parts = [stage.push(gyro, motion.time_ns), stage.finish()]
    q = motion.q_nb[0]
    worst = 0.0
    for part in parts:
        for sample, phi in zip(part.sample, part.rotation_vector, strict=True):
            q = rotation.multiply(q, rotation.exp(phi))
            error = rotation.log(rotation.multiply(rotation.conjugate(q), motion.q_nb[sample]))
            worst = max(worst, np.linalg.norm(error))
    assert worst < 2e-8  # no compensation: 5e-6 by now; one interval left out: 1e-3


def test_nothing_comes_of_nothing():
    stage = ConingStage(ALGORITHMS["previous-3"], "rate")
    assert len(stage.push(np.empty((0, 3)), np.empty(0, dtype=np.int64)).sample) == 0
    assert len(stage.finish().sample) == 0
    with pytest.raises(RuntimeError, match="finished"):
        stage.push(*log(2))
    with pytest.raises(RuntimeError, match="finished"):
        stage.finish()


def test_bad_samples_are_refused():
    gyro, time_ns = log(6)
    stage = ConingStage(ALGORITHMS["previous-3"], "rate")
    with pytest.raises(ValueError, match="shapes"):
        stage.push(gyro[:, :2], time_ns)
    with pytest.raises(ValueError, match="integer"):
        stage.push(gyro, time_ns * 1e-9)
    with pytest.raises(ValueError, match="increase"):
        stage.push(gyro, time_ns[::-1])
    stage.push(gyro, time_ns)
    with pytest.raises(ValueError, match="increase"):
        stage.push(gyro[:1], time_ns[-1:])


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="gyro_kind"):
        ConingStage(ALGORITHMS["previous-3"], "increments")
    for kind in ("mean-rate", "increment"):
        with pytest.raises(ValueError, match="nominal_interval"):
            ConingStage(ALGORITHMS["previous-3"], kind)
        with pytest.raises(ValueError, match="nominal_interval"):
            ConingStage(ALGORITHMS["previous-3"], kind, nominal_interval=0.0)
    with pytest.raises(ValueError, match="points"):
        ConingStage(ALGORITHMS["previous-3"], "rate", points=3)
