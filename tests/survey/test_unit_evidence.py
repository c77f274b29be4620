"""deg/s and g are detected, and never where they are not.

Of the real logs, read in deg/s, all hold enough tilt motion for gravity to tell, or rates beyond
any sensor's, or would roll over where their specific force stays on one axis of the body.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.units import DEGREE
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import ImuUnits
from sinstool.io.readers.topics import choose_imu
from sinstool.methods.alignment.still import WindowStage
from sinstool.survey.imu import survey
from sinstool.survey.unit_evidence import (
    UnitEvidence,
    accel_looks_like_g,
    gyro_looks_like_degrees,
    turns_like_degrees,
    unit_evidence,
)
from tests.helpers import unseen_drives as unseen
from tests.helpers.imulogs import REAL, G, even_times, handheld, resting
from tests.helpers.logs import real
from tests.helpers.unseen_vehicles import VEHICLES

RATE = 200.0


def judge(gyro, accel, rate=RATE):
    stage = WindowStage()
    stage.push(even_times(len(gyro), rate), gyro, accel)
    evidence = unit_evidence(stage.finish())
    return gyro_looks_like_degrees(evidence, np.abs(gyro).max(axis=0)), evidence


def spinning(rate_rad_s, axis, count=8000):
    """A steady spin about an axis of the body."""
    rate = rate_rad_s * np.asarray(axis) / np.linalg.norm(axis)
    turned = Rotation.from_rotvec(np.arange(count)[:, None] / RATE * rate)
    gyro, accel = resting(count)
    return gyro + rate, turned.inv().apply([0.0, 0.0, G]) + accel - [0.0, 0.0, G]


def vehicle(seed, count=40_000):
    """Turns about the vertical, small pitch and roll, and accelerations as strong as those."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / RATE
    window = np.hanning(801) / np.hanning(801).sum()
    drift = np.array(
        [np.convolve(rng.standard_normal(count + 800), window, "valid") for _ in "abc"]
    )
    tilt = np.radians(60.0) * drift[:2]
    heading_rate = 0.5 * np.sin(2 * np.pi * t / 30.0) ** 3
    roll_rate, pitch_rate = np.gradient(tilt, 1 / RATE, axis=1)
    gyro = np.stack((roll_rate, pitch_rate, heading_rate), axis=1)
    accel = np.stack((-np.sin(tilt[1]), np.sin(tilt[0]), np.ones(count)), axis=1) * G
    accel[:, :2] += 5.0 * drift[:2].T[::-1]
    noise = rng.standard_normal((count, 6))
    return gyro + 0.005 * noise[:, :3], accel + 0.5 * noise[:, 3:]


def multirotor(seed, count=20_000):
    """Leans by up to half a radian; the thrust that holds it up is all that it feels."""
    rng = np.random.default_rng(seed)
    window = np.hanning(401) / np.sqrt(np.sum(np.hanning(401) ** 2))
    lean = np.array([np.convolve(rng.standard_normal(count + 400), window, "valid") for _ in "ab"])
    lean = 0.5 * np.tanh(lean)
    heading = 0.3 * np.arange(count) / RATE
    turned = Rotation.from_euler("ZYX", np.stack([heading, lean[0], lean[1]], axis=1))
    gyro = RATE * (turned[:-1].inv() * turned[1:]).as_rotvec()
    gyro = np.vstack([gyro, gyro[-1:]]) + 0.01 * rng.standard_normal((count, 3))
    thrust = 0.3 * rng.standard_normal((count, 3))
    thrust[:, 2] += G / np.prod(np.cos(lean), axis=0)
    return gyro, thrust


def dancer(seed, count=30_000):
    """Upright, leaning by some 15 degrees, and turning at up to 30 rad/s for a second or two."""
    rng = np.random.default_rng(seed)
    window = np.hanning(201) / np.sqrt(np.sum(np.hanning(201) ** 2))
    lean = np.array([np.convolve(rng.standard_normal(count + 200), window, "valid") for _ in "ab"])
    rate, first = np.zeros(count), 400
    while first < count - 1000:
        length = int(rng.uniform(0.6, 2.5) * RATE)
        peak = rng.choice([-1.0, 1.0]) * rng.uniform(6.0, 30.0)
        rate[first : first + length] = peak * np.sin(np.linspace(0.0, np.pi, length)) ** 2
        first += length + int(rng.uniform(0.3, 3.0) * RATE)
    heading = np.cumsum(rate) / RATE
    angles = np.stack([heading, 0.2 * lean[0], 0.2 * lean[1]], axis=1)
    turned = Rotation.from_euler("ZYX", angles)
    gyro = RATE * (turned[:-1].inv() * turned[1:]).as_rotvec()
    gyro = np.vstack([gyro[:1], gyro]) + 0.01 * rng.standard_normal((count, 3))
    sway = 2.0 * np.sin(2.0 * np.pi * 0.7 * np.arange(count) / RATE)
    moved = np.stack([sway, np.roll(sway, 150), np.full(count, G)], axis=1)
    return gyro, turned.inv().apply(moved) + 0.05 * rng.standard_normal((count, 3))


MOTIONS = {
    **{f"hand {s}": lambda s=s: handheld(8000, seed=s)[:2] for s in range(6)},
    **{f"quick hand {s}": lambda s=s: handheld(8000, seed=s, size=6.0)[:2] for s in range(3)},
    **{
        f"shaken {s}": lambda s=s: handheld(8000, seed=s, size=12.0, slowness_s=0.15)[:2]
        for s in range(3)
    },
    "tumbling": lambda: handheld(8000, seed=9, size=15.0, slowness_s=2.0)[:2],
    **{f"vehicle {s}": lambda s=s: vehicle(s) for s in range(3)},
}
# Turns that are over within half a second
QUICK = {f"dancer {s}": lambda s=s: dancer(s) for s in range(4)}
# Motions of which gravity does not show the unit; rates beyond any sensor's still may.
MUTE = {
    **{
        f"spin of {w:g} rad/s about {axis}": lambda w=w, axis=axis: spinning(w, axis)
        for w in (0.5, 3.0, 12.0, 35.0, 40.0)
        for axis in ((1, 0, 0), (0, 0, 1), (1, 2, 3))
    },
    **{f"multirotor {s}": lambda s=s: multirotor(s) for s in range(6)},
    "rest": lambda: resting(720_000),
    "rest of a coarse gyro": lambda: resting(72_000, gyro_noise=0.05, accel_noise=0.3),
}


def saturated(gyro):
    """At 250 deg/s, half of what the motion has."""
    limit = np.abs(gyro).max() / 2
    return np.clip(gyro, -limit, limit)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*MOTIONS, *MUTE, *QUICK])
def test_rates_in_rad_s_are_left_alone(name):
    gyro, accel = {**MOTIONS, **MUTE, **QUICK}[name]()
    assert not judge(gyro, accel)[0]
    if (
        "spin" not in name and name not in QUICK
    ):  # at half its rate a steady spin is another motion altogether
        assert not judge(saturated(gyro), accel)[0]
    bias = np.array([0.077, -0.05, 0.03])  # 4.4 deg/s
    assert not judge(gyro + bias, accel)[0]


@pytest.mark.parametrize("name", MOTIONS)
def test_rates_in_deg_s_are_found(name):
    gyro, accel = MOTIONS[name]()
    result, evidence = judge(gyro / DEGREE, accel)
    assert result
    # a vehicle also accelerates; in the hand, gravity turns as said
    assert 0.2 < evidence.scale < 1.5
    if "vehicle" not in name:
        assert judge(saturated(gyro / DEGREE), accel)[0]


@pytest.mark.parametrize("name", QUICK)
def test_quick_turns_in_deg_s_are_found(name):
    gyro, accel = QUICK[name]()
    assert judge(gyro / DEGREE, accel)[0]


def test_one_flip_does_not_make_a_multirotor_one_in_degrees():
    gyro, accel = multirotor(1, 60_000)
    gyro[30_000:30_200, 0] += 2.0 * np.pi
    assert not judge(gyro, accel)[0]


@pytest.mark.slow
def test_vehicles_that_never_tilt_much_are_recognised_by_how_they_would_roll_over():
    """By another program's simulation: lift or a road holds the specific force on one axis."""
    motions = (unseen.drive, unseen.flight, unseen.multicopter, unseen.boat, *VEHICLES.values())
    for seed, motion in enumerate(motions, 40):
        data = unseen.record(motion(seed, 300.0), unseen.GRADES["industrial"], seed)
        rate, force = data.gyro * RATE, data.accel * RATE
        assert not judge(rate, force)[0], motion.__name__
        assert judge(rate / DEGREE, force)[0], motion.__name__


def test_scale_is_one_for_degrees_and_57_for_radians():
    gyro, accel, _ = handheld(8000, size=0.3, slowness_s=3.0, noise=1e-5)
    assert judge(gyro / DEGREE, accel)[1].scale == pytest.approx(1.0, abs=0.02)
    assert judge(gyro, accel)[1].scale == pytest.approx(1 / DEGREE, rel=0.02)


def test_rates_beyond_any_sensor():
    gyro, accel = multirotor(0)
    assert judge(gyro / DEGREE, accel)[0]  # gravity says nothing, the rates reach 200
    gyro, accel = resting(2000)
    gyro[500] = 150.0
    assert judge(gyro, accel)[0]
    # a spike amid motion that is surely in rad/s is a spike
    gyro, accel, _ = handheld(8000, noise=1e-3, size=1.0)
    gyro[500] = 150.0
    assert not judge(gyro, accel)[0]


@pytest.mark.parametrize(
    ("evidence", "expected"),
    [
        (UnitEvidence(1.0, 0.1, 50, 0.9), True),
        (UnitEvidence(0.4, 0.1, 10, 0.6), True),
        (UnitEvidence(1.0, 0.1, 9, 0.9), False),  # too little to go by
        (UnitEvidence(1.0, 0.1, 50, 0.5), False),  # rad/s fits as often
        (UnitEvidence(1.0, 0.6, 50, 0.9), False),  # could be nothing at all
        (UnitEvidence(6.0, 0.6, 50, 0.9), False),  # could be rad/s
        (UnitEvidence(30.0, 1.0, 50, 0.9), False),
        (UnitEvidence(-1.0, 0.1, 50, 0.9), False),
        (UnitEvidence(1.0, 0.1, 50, 0.9, 0.02, 0.01), False),  # far turns in rad/s keep gravity
        (UnitEvidence(1.0, 0.1, 20, 0.9, 0.02, 0.01), True),
        (UnitEvidence(1.0, 0.1, 20, 0.9, 0.01, 0.02), False),
        (UnitEvidence(4.3, 0.8, 26, 1.0, 0.038, 0.031), False),  # either is an accelerometer's bias
        (UnitEvidence(0.1, 0.5, 50, 0.9, 0.30, 0.02), True),  # and here they do not
        (UnitEvidence(0.1, 0.5, 50, 0.9, 0.72, 0.22), False),  # windows resolve neither
    ],
)
def test_what_evidence_is_enough(evidence, expected):
    assert turns_like_degrees(evidence) is expected
    assert gyro_looks_like_degrees(evidence, np.full(3, 50.0)) is expected
    # rates that no sensor has decide unless the data is surely in rad/s
    assert gyro_looks_like_degrees(evidence, np.full(3, 500.0)) is (evidence.scale < 20.0)


def test_nothing_is_said_of_nothing():
    stage = WindowStage()
    for gyro, accel in (np.zeros((2, 0, 3)), np.zeros((2, 50, 3)), np.zeros((2, 1000, 3))):
        stage = WindowStage()
        stage.push(even_times(len(gyro)), gyro, accel)
        evidence = unit_evidence(stage.finish())
        assert (evidence.scale, evidence.sigma, evidence.windows) == (0.0, np.inf, 0)
        assert not turns_like_degrees(evidence)


@pytest.mark.parametrize("size", [0.9, 0.97, 1.0, 1.02, 1.1])
def test_g(size):
    assert accel_looks_like_g(size)
    assert not accel_looks_like_g(size * G)


@pytest.mark.parametrize("path", REAL)
@pytest.mark.parametrize("unit", ["rad/s", "deg/s"])
def test_real_logs(path, unit):
    axes = "frd" if path.startswith("px4") else "flu"
    scale = 1.0 if unit == "rad/s" else 1.0 / DEGREE
    with open_log(real(path)) as log:
        topic = choose_imu(log, None)
        actual = survey(log, topic, ImuUnits(axes, scale))
        in_g = survey(log, topic, ImuUnits(axes, scale, 1.0 / G))
    expected = unit == "deg/s"
    assert gyro_looks_like_degrees(actual.gyro_unit, actual.gyro_max) is expected
    assert not accel_looks_like_g(actual.specific_force_median)
    assert accel_looks_like_g(in_g.specific_force_median)
    # the unit of force does not matter to that of the rates
    assert gyro_looks_like_degrees(in_g.gyro_unit, in_g.gyro_max) is expected


def test_coordinated_turns_are_no_degrees():
    """Rolling into turns of 35 degrees the lift stays on the aircraft's own axis."""
    from sinstool.methods.alignment.still import WindowStage
    from sinstool.simulation.flight import manoeuvring_flight

    for seed in range(4):
        imu = manoeuvring_flight(400.0, 50.0, latitude=-0.6, heading=2.0, seed=seed).imu
        stage = WindowStage()
        stage.push(imu.time_ns, imu.gyro_mean_rate, imu.mean_specific_force)
        evidence = unit_evidence(stage.finish())
        assert not turns_like_degrees(evidence)
