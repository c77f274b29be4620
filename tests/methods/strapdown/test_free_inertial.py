"""Inertial navigation of a run: block edges, gaps, rest, what it does when all is lost."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.height import layout
from sinstool.methods.height.network import HeightNetwork, gravity_gradient
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.strapdown.free_inertial import InsRun, InsSettings
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.simulation.flight import manoeuvring_flight

T0 = 1_700_000_000_000_000_000
LATITUDE = np.radians(-43.5)
KINDS = {"rate": "gyro_rate", "mean-rate": "gyro_mean_rate", "increment": "gyro_increment"}


@pytest.fixture(scope="module")
def flight():
    return manoeuvring_flight(
        90.0, 100.0, latitude=LATITUDE, longitude=np.radians(179.997), height=800.0, heading=1.4,
        turbulence=1.0, seed=3, start_ns=T0,
    )  # fmt: skip


def samples(flight, kind="mean-rate"):
    truth = flight.imu
    force = truth.specific_force if kind == "rate" else truth.mean_specific_force
    if kind == "increment":
        force = force * truth.interval[:, None]
    return Imu(truth.time_ns, truth.time_ns, getattr(truth, KINDS[kind]), force)


def state(flight):
    return initial_state(
        flight.latitude[0], flight.longitude[0], flight.height[0], flight.velocity_n[0],
        flight.imu.q_nb[0],
    )  # fmt: skip


def reference(flight, rate=50.0, shift=0.004, **changes):
    time_ns = T0 + np.arange(0, 90 * SECOND, round(SECOND / rate)) + round(shift * SECOND)
    height = np.interp((time_ns - T0) * 1e-9, (flight.time_ns - T0) * 1e-9, flight.height)
    none = np.zeros(len(time_ns), np.int64)
    options = {
        "kind": "baro", "topic": "/baro", "time_ns": time_ns,
        "height": height, "reason": none, "sigma": 0.0, "baro": None,
    }  # fmt: skip
    return HeightReference(**(options | changes))


def settings(kind="mean-rate", coning="previous-3", heights=None, tau=5.0, **options):
    network = HeightNetwork(tau, 0.0, gravity_gradient(LATITUDE))
    parameters = None if heights is None else layout.new_parameters(network, "mems")
    return InsSettings(
        algorithm=algorithm(coning), gyro_kind=kind, nominal_ns=1e7, max_gap_ns=round(3.5e7),
        parameters=parameters, reference=heights, **options,
    )  # fmt: skip


def navigate(imu, start, how, size=None):
    blocks = [imu.rows(slice(k, k + (size or len(imu)))) for k in range(0, len(imu), size or 10**9)]
    run = InsRun(start, how)
    parts = list(run.run(blocks))
    names = [name for name, column in vars(parts[0]).items() if column is not None]
    return run, {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}


def metres(position, other):
    """Difference of positions, north, east, up; over the date line too."""
    off = position - other
    off[..., 1] = (off[..., 1] + np.pi) % (2.0 * np.pi) - np.pi
    return off * [6.36e6, 4.63e6, 1.0]


def truth(flight):
    return np.stack([flight.latitude, flight.longitude, flight.height], axis=1)


def bad_heights(flight):
    """Heights with spikes, a gap with a coast, a jump and stamps that repeat."""
    result = reference(flight)
    height, times = result.height.copy(), result.time_ns.copy()
    height[500:520:7] += 200.0
    height[3500:] += 40.0
    times[700] = times[699]
    keep = ((times - T0) * 1e-9 < 30.0) | ((times - T0) * 1e-9 > 41.0)
    return replace(result, time_ns=times[keep], height=height[keep], reason=result.reason[keep])


def with_gaps(imu):
    """A short gap, one that is carried over at constant velocity, and one that is very long."""
    t = (imu.time_ns - T0) * 1e-9
    out = ((t > 20.0) & (t < 20.3)) | ((t > 50.0) & (t < 52.0)) | ((t > 60.0) & (t < 66.0))
    return imu.rows(~out)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "coning"),
    [
        ("rate", "previous-3"),
        ("mean-rate", "lookahead-12"),
        ("increment", "optimal-4"),
        ("rate", "singular-perturbation"),
    ],
)
def test_block_edges_do_not_matter(flight, kind, coning):
    imu = with_gaps(samples(flight, kind))
    how = settings(kind, coning, bad_heights(flight), still_until_ns=T0 + 2 * SECOND)
    run, whole = navigate(imu, state(flight), how)
    assert {"coast", "re-engaged", "jump", "imu-gap"} <= {e.kind for e in run.events}
    assert run.gaps_s == pytest.approx(0.3 + 2.0 + 6.0, abs=0.1)
    for size in (1, 7, 4096):
        if size == 1:  # slow: the beginning, with the first gap
            part = imu.rows(slice(0, 2500))
            expected = navigate(part, state(flight), how)
        else:
            part, expected = imu, (run, whole)
        again, actual = navigate(part, state(flight), how, size)
        for name, column in expected[1].items():
            np.testing.assert_array_equal(actual[name], column, err_msg=f"{name}, {size}")
        assert again.events == expected[0].events
        assert again.channel == expected[0].channel
        assert again.updates == expected[0].updates


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_is_met(flight, kind):
    for heights in (None, reference(flight)):
        _, result = navigate(samples(flight, kind), state(flight), settings(kind, heights=heights))
        assert len(result["time_ns"]) == len(flight.time_ns)
        assert np.abs(metres(result["position"], truth(flight))).max() < 1e-3
        assert np.abs(result["velocity_n"] - flight.velocity_n).max() < 1e-3
    # the longitude went over the date line
    assert result["position"][:, 1].max() > 3.0 and result["position"][:, 1].min() < -3.0


def test_a_lead_in_at_rest_is_left_out(flight):
    until = T0 + 20 * SECOND
    how = settings(heights=reference(flight), still_until_ns=until)
    run, result = navigate(samples(flight), state(flight), how)
    still = result["time_ns"] <= until
    for name in ("position", "velocity_n", "q_nb", "vertical"):
        np.testing.assert_array_equal(result[name][still], result[name][:1].repeat(still.sum(), 0))
    assert run.events[0].kind == "engaged" and run.events[0].time > 20.0
    assert run.channel.samples["accepted"] < 3501


def test_over_short_gaps_the_vehicle_goes_on_as_it_did(flight):
    imu = samples(flight)
    t = (imu.time_ns - T0) * 1e-9
    full = navigate(imu, state(flight), settings())[1]
    run, result = navigate(imu.rows(~((t > 5.0) & (t < 5.3))), state(flight), settings())
    at = np.searchsorted(full["time_ns"], result["time_ns"])
    moved = metres(result["position"], full["position"][at])
    assert run.gaps_s == pytest.approx(0.3)
    # turbulence in 0.3 s: a tenth of a degree, millimetres
    assert np.abs(moved[result["time_ns"] < T0 + 6 * SECOND]).max() < 0.05
    assert np.abs(result["velocity_n"] - full["velocity_n"][at])[:600].max() < 0.2


def test_over_long_gaps_velocity_is_kept(flight):
    imu = samples(flight)
    t = (imu.time_ns - T0) * 1e-9
    heights = reference(flight)
    imu = imu.rows(~((t > 2.0) & (t < 8.0)))
    run, result = navigate(imu, state(flight), settings(heights=heights))
    k = int(np.argmax(np.diff(result["time_ns"])))
    np.testing.assert_allclose(result["velocity_n"][k + 1], result["velocity_n"][k], atol=1e-6)
    moved = metres(result["position"][k + 1], result["position"][k])[:2]
    np.testing.assert_allclose(moved, 6.01 * result["velocity_n"][k, :2], rtol=5e-3)
    kinds = [e.kind for e in run.events]
    assert kinds.count("imu-gap") == 1 and kinds.count("engaged") == 2
    # the attitude of the turbulence is lost, but the barometer has the height back soon
    late = result["time_ns"] > T0 + 40 * SECOND
    assert np.abs(result["vertical"][late, 0] - flight.height[t > 40.0]).max() < 1.0


def test_a_shadow_flies_on_over_a_gap(flight):
    """In a climb; a coast soon after would begin from a wrong velocity and correction."""
    calm = manoeuvring_flight(
        100.0, 100.0, latitude=LATITUDE, height=800.0, turbulence=0.0, seed=3, start_ns=T0
    )
    imu = samples(calm)
    t = (imu.time_ns - T0) * 1e-9
    begin = 85.0
    assert np.all(calm.velocity_n[t > begin, 2] < -4.0)
    heights = reference(calm)
    heights = heights_until(heights, begin + 0.5)
    gap = (t > begin) & (t < begin + 0.4)
    run, result = navigate(imu.rows(~gap), state(calm), settings(heights=heights))
    assert [e.kind for e in run.events] == ["engaged", "imu-gap", "coast"]
    late = result["time_ns"] > T0 + round((begin + 3.0) * SECOND)
    assert np.abs(result["vertical"][late, 1] + calm.velocity_n[~gap][late, 2]).max() < 0.02


def heights_until(heights, seconds):
    keep = heights.time_ns < T0 + round(seconds * SECOND)
    columns = ("time_ns", "height", "reason")
    return replace(heights, **{name: getattr(heights, name)[keep] for name in columns})


def test_what_has_left_the_earth_is_held(flight):
    imu = samples(flight)
    imu = replace(imu, accel=imu.accel - np.array([0.0, 0.0, 1e4]))
    runs = [navigate(imu, state(flight), settings(), size) for size in (None, 64, 5)]
    for run, columns in runs:
        assert run.diverged_ns == runs[0][0].diverged_ns
        for name, column in columns.items():
            assert np.isfinite(column).all(), name
            np.testing.assert_array_equal(column, runs[0][1][name])
        late = columns["time_ns"] > run.diverged_ns
        assert late.sum() > 1000
        assert np.all(columns["position"][late] == columns["position"][late][0])
        assert np.all(columns["velocity_n"][late] == 0.0)


def test_heights_go_by_the_stamps_where_a_rate_is_believed(flight):
    """Stamps run 1 % slow against the rate that is believed."""
    imu = samples(flight)
    stamps = T0 + np.round((imu.time_ns - T0) * 1.01).astype(np.int64)
    stretched = replace(imu, time_ns=stamps, log_time_ns=stamps)
    result = reference(flight)
    times = T0 + np.round((result.time_ns - T0) * 1.01).astype(np.int64)
    heights = replace(result, time_ns=times)
    how = replace(settings(heights=heights, sample_rate=100.0), nominal_ns=1.01e7)
    _, columns = navigate(stretched, state(flight), how)
    assert np.abs(columns["vertical"][:, 0] - flight.height).max() < 0.1


def test_a_correction_is_no_motion_over_a_gap(flight):
    """Of a biased accelerometer: what the network takes off all the time moves nothing."""
    imu = samples(flight)
    t = (imu.time_ns - T0) * 1e-9
    imu = replace(imu, accel=imu.accel + np.array([0.0, 0.0, -0.4]))
    imu = imu.rows(~((t > 60.0) & (t < 63.0)))
    run, result = navigate(imu, state(flight), settings(heights=reference(flight)))
    assert "imu-gap" in [e.kind for e in run.events]
    k = int(np.argmax(np.diff(result["time_ns"])))
    climbed = result["position"][k + 1, 2] - result["position"][k, 2]
    # 0.4 m/s^2 in 3 s would be 1.8 m
    expected = -3.01 * result["velocity_n"][k, 2]
    assert climbed == pytest.approx(expected, abs=1e-6)


def test_heights_from_before_the_first_sample_are_not_used(flight):
    """They were compared with the height at the start, and took it for jumps of the barometer."""
    later = flight.imu.time_ns >= T0 + 40 * SECOND
    k = int(np.argmax(later))
    begun = initial_state(
        flight.latitude[k], flight.longitude[k], flight.height[k], flight.velocity_n[k],
        flight.imu.q_nb[k],
    )  # fmt: skip
    heights = reference(flight)
    run, whole = navigate(samples(flight).rows(slice(k, None)), begun, settings(heights=heights))
    good = heights.time_ns >= flight.imu.time_ns[k]
    cut = replace(heights, time_ns=heights.time_ns[good], height=heights.height[good],
                  reason=heights.reason[good])  # fmt: skip
    _, alone = navigate(samples(flight).rows(slice(k, None)), begun, settings(heights=cut))
    np.testing.assert_array_equal(whole["position"], alone["position"])
    assert [event.kind for event in run.events] == ["engaged"]
