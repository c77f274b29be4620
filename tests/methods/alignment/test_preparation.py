import numpy as np
import pytest

from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment.inflight_types import (
    AlignmentSettings,
    GnssFixes,
    ImuIncrements,
)
from sinstool.methods.alignment.preparation import (
    gap_edges,
    noise_level,
    prepare_fixes,
    stretches,
)

MS = 1_000_000


def imu(count=4000, step_ms=5):
    rng = np.random.default_rng(1)
    time = 100 + np.arange(count) * step_ms * MS
    theta = 1e-5 * rng.normal(size=(count, 3))
    return ImuIncrements(time, theta, np.tile([0.01, 0.0, -0.049], (count, 1)))


def without(samples, drop):
    mask = np.ones(len(samples), dtype=bool)
    mask[drop] = False
    return ImuIncrements(
        samples.time_ns[mask], samples.delta_theta[mask], samples.delta_velocity[mask]
    )


def fixes(count=300, step_ms=100, **changes):
    columns = {
        "time_ns": np.arange(count) * step_ms * MS,
        "latitude": np.full(count, -0.6),
        "longitude": np.full(count, 2.5),
        "height": np.full(count, 500.0),
        "velocity_n": np.tile([100.0, 20.0, -3.0], (count, 1)),
    }
    return GnssFixes(**{**columns, **changes})


def test_short_gaps_are_bridged_in_calm_flight():
    samples = imu()
    parts, warnings = stretches(without(samples, slice(1000, 1003)), AlignmentSettings())
    assert len(parts) == 1 and "1 gap of up to" in warnings[0]
    # The sample after held its usual 5 ms only: the motion on both sides goes on over the other 15
    for name in ("delta_velocity", "delta_theta"):
        before, after = getattr(samples, name)[[999, 1003]]
        expected = after + 1.5 * (before + after)
        np.testing.assert_allclose(getattr(parts[0].imu, name)[1000], expected)
    assert parts[0].imu.delta_velocity.sum() == pytest.approx(samples.delta_velocity.sum())


def test_whole_increments_over_a_gap_stay():
    samples = imu()
    shorter = without(samples, slice(1000, 1003))
    shorter.delta_velocity[1000] = samples.delta_velocity[1000:1004].sum(axis=0)
    parts, _ = stretches(shorter, AlignmentSettings())
    np.testing.assert_array_equal(parts[0].imu.delta_velocity, shorter.delta_velocity)


def test_longer_gaps_are_bridged_in_any_motion_only_if_asked():
    samples = imu()
    samples.delta_theta[:, 0] = np.deg2rad(50.0) * 0.005
    shorter = without(samples, slice(1000, 1010))
    assert len(stretches(shorter, AlignmentSettings())[0]) == 2
    parts, warnings = stretches(shorter, AlignmentSettings(), bridged_ns=60 * MS)
    assert len(parts) == 1 and "0.055 s" in warnings[0]
    turned = parts[0].imu.delta_theta[:, 0].sum()
    assert turned == pytest.approx(samples.delta_theta[:, 0].sum())


def test_long_gaps_interrupt_the_attitude():
    parts, warnings = stretches(without(imu(), slice(1000, 1004)), AlignmentSettings())
    assert [len(p.imu) for p in parts] == [1000, 2996]
    assert parts[1].after == "a gap of 0.025 s in the IMU"
    assert "interrupts the alignment" in warnings[0]


def test_a_gap_breaks_the_chain_while_turning_and_what_is_none_does_not():
    samples = imu()
    samples.delta_theta[900:1100, 0] = np.deg2rad(50.0) * 0.005
    cut = without(samples, slice(1000, 1003))
    assert [len(p.imu) for p in stretches(cut, AlignmentSettings())[0]] == [1000, 2997]
    # one definition, and one option
    assert len(stretches(cut, AlignmentSettings(max_gap_ns=21e6))[0]) == 1
    (one,), warnings = stretches(without(samples, slice(1000, 1001)), AlignmentSettings())
    assert not warnings
    assert one.imu.delta_theta.sum() == pytest.approx(samples.delta_theta.sum(), rel=1e-3)
    short = AlignmentSettings(max_gap_ns=6e6)
    assert len(stretches(without(samples, slice(1000, 1001)), short)[0]) == 2


def test_stamps_that_jitter_are_no_gaps():
    random = np.random.default_rng(2)
    ticks = np.cumsum(random.choice([1, 2, 4], 3000, p=[0.25, 0.65, 0.1]))
    samples = imu(int(ticks[-1]) + 1)
    samples.delta_theta[:, 2] = np.deg2rad(20.0) * 0.005
    totals = [np.diff(np.cumsum(v, axis=0)[ticks], axis=0, prepend=0.0)
              for v in (samples.delta_theta, samples.delta_velocity)]  # fmt: skip
    uneven = ImuIncrements(samples.time_ns[ticks], *totals)
    (one,), warnings = stretches(uneven, AlignmentSettings())
    assert not warnings
    np.testing.assert_array_equal(one.imu.delta_theta, uneven.delta_theta)


def test_saturated_samples_belong_to_no_stretch():
    samples = imu()
    samples.delta_theta[500:520, 2] = -3.0 * 0.005
    parts, warnings = stretches(samples, AlignmentSettings(gyro_limit=3.0))
    assert [len(p.imu) for p in parts] == [500, 4000 - 521]
    assert parts[1].after == "saturated samples"
    assert "21 saturated" in warnings[0] and "2.60 s after" in warnings[0]
    parts, warnings = stretches(samples, AlignmentSettings(gyro_limit=3.1))
    assert len(parts) == 1 and not warnings


def test_start_and_end():
    samples = imu()
    settings = AlignmentSettings(start_ns=int(samples.time_ns[10]), end_ns=int(samples.time_ns[99]))
    parts, _ = stretches(samples, settings)
    np.testing.assert_array_equal(parts[0].imu.time_ns, samples.time_ns[10:100])
    with pytest.raises(AlignmentError, match="no IMU samples"):
        stretches(samples, AlignmentSettings(start_ns=10**15))


def test_repeats_are_dropped_and_backward_time_refused():
    samples = imu(50)
    twice = np.sort(np.concatenate([np.arange(50), [7, 7, 9]]))
    again = ImuIncrements(
        samples.time_ns[twice], samples.delta_theta[twice], samples.delta_velocity[twice]
    )
    parts, warnings = stretches(again, AlignmentSettings())
    np.testing.assert_array_equal(parts[0].imu.time_ns, samples.time_ns)
    assert "3 IMU samples with repeated times" in warnings[0]
    with pytest.raises(AlignmentError, match="IMU time runs backward after sample 0"):
        ImuIncrements(samples.time_ns[::-1], samples.delta_theta, samples.delta_velocity)
    with pytest.raises(AlignmentError, match="not finite"):
        ImuIncrements(samples.time_ns, samples.delta_theta * np.nan, samples.delta_velocity)
    with pytest.raises(ValueError, match="delta_velocity"):
        ImuIncrements(samples.time_ns, samples.delta_theta, samples.delta_velocity[:-1])


def test_fixes_are_stamped_when_valid():
    gnss, _, warnings = prepare_fixes(fixes(), AlignmentSettings(gnss_latency_s=0.08))
    assert gnss.time_ns[0] == -80 * MS and not warnings
    np.testing.assert_array_equal(gnss.sigma_v, 0.1)


def test_noise_of_each_fix():
    sigma = np.full(300, 0.12)
    sigma[:3] = np.nan, 0.0, -1.0
    gnss, _, _ = prepare_fixes(fixes(sigma_v=sigma), AlignmentSettings(gnss_sigma_v=0.2))
    np.testing.assert_array_equal(gnss.sigma_v[:5], [0.2, 0.2, 0.2, 0.12, 0.12])


def test_fixes_without_place_or_of_repeated_time():
    latitude = np.full(300, 0.3)
    latitude[20] = np.nan
    time = np.arange(300) * 100 * MS
    time[50] = time[49]
    gnss, _, warnings = prepare_fixes(fixes(latitude=latitude, time_ns=time), AlignmentSettings())
    assert len(gnss) == 298 and "1 fix with repeated times left out" in warnings[0]


def missing(count, which):
    velocity = np.tile([100.0, 20.0, -3.0], (count, 1))
    velocity[which, 1] = np.nan
    return velocity


def test_missing_velocity():
    few = fixes(velocity_n=missing(300, slice(0, 300, 10)))
    gnss, settings, warnings = prepare_fixes(few, AlignmentSettings())
    assert len(gnss) == 270 and settings.vectors == "win" and not warnings
    many = fixes(velocity_n=missing(300, slice(0, 300, 2)))
    gnss, settings, warnings = prepare_fixes(many, AlignmentSettings())
    assert len(gnss) == 150 and settings.vectors == "win" and "50%" in warnings[0]


def test_positions_alone():
    long = fixes(700, velocity_n=missing(700, slice(None)))
    gnss, settings, warnings = prepare_fixes(long, AlignmentSettings(method="triad"))
    assert len(gnss) == 700 and (settings.vectors, settings.method) == ("pos", "svd")
    assert "no velocity" in warnings[0] and "by svd, as triad needs velocity" in warnings[0]
    short = fixes(300, velocity_n=missing(300, slice(None)))
    with pytest.raises(AlignmentError, match="needs GNSS velocity for 10 s"):
        prepare_fixes(short, AlignmentSettings())
    # of a log with 70 s of fixes, where 10 s of them count
    with pytest.raises(AlignmentError, match=r"in the span to align with .* positions for 9\.9 s"):
        prepare_fixes(long, AlignmentSettings(start_ns=600 * 100 * MS))
    gnss, _, _ = prepare_fixes(short, AlignmentSettings(vectors="pos"))
    assert len(gnss) == 300


def test_triad_takes_no_positions():
    """It ignores the vectors that are asked for: it integrates velocity, or gives way to svd."""
    asked = AlignmentSettings(method="triad", vectors="pos")
    _, settings, warnings = prepare_fixes(fixes(), asked)
    assert (settings.vectors, settings.method) == ("int", "triad") and not warnings
    _, settings, warnings = prepare_fixes(fixes(700, velocity_n=missing(700, slice(None))), asked)
    assert (settings.vectors, settings.method) == ("pos", "svd") and "triad" in warnings[0]


def test_gaps_of_fixes():
    time = np.array([0.0, 1.0, 2.0, 40.0, 41.0, 102.0, 103.0])
    edges, longest = gap_edges(time)
    np.testing.assert_array_equal(edges, [5])
    assert longest == 38.0
    assert gap_edges(time[:1])[1] == 0.0


def test_rough_fixes_are_left_out_and_slow_changes_stay():
    sigma = np.where(np.arange(300) < 150, 0.1, 0.5)  # worse from 15 s on: no single fixes
    sigma[::9] *= 3.0
    gnss, _, warnings = prepare_fixes(fixes(sigma_v=sigma), AlignmentSettings())
    left = np.setdiff1d(np.arange(300), gnss.time_ns // (100 * MS))
    assert np.all(left % 9 == 0) and len(left) >= 31  # but for some at the change itself
    assert f"{len(left)} of 300 fixes are not used" in warnings[0]
    level = noise_level(sigma, 0.1)
    assert np.all(level[:140] == 0.1) and np.all(level[160:] == 0.5)
    np.testing.assert_array_equal(noise_level(np.full(3, 0.2), 0.0), 0.2)


@pytest.mark.parametrize("vectors", ["win", "pos"])
def test_velocities_much_noisier_than_their_neighbours_spoil_no_positions(vectors):
    sigma = np.full(300, 0.05)
    sigma[[40, 41, 200]] = 3.0
    good, _, warnings = prepare_fixes(fixes(sigma_v=sigma), AlignmentSettings(vectors=vectors))
    if vectors == "pos":
        assert len(good) == 300 and not warnings
    else:
        assert len(good) == 297 and "3 of 300 fixes are not used" in warnings[0]
