"""What real logs do, each built with stock writers, and the warning that names it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import InputOptions
from sinstool.core.finding import Severity
from sinstool.io.readers import open_log
from sinstool.io.readers.topics import choose_imu
from sinstool.survey.imu import survey
from sinstool.survey.oddities import gravity_axis, oddities
from sinstool.survey.source import imu_units
from tests.helpers.imulogs import (
    T0,
    G,
    even_times,
    handheld,
    imu_log,
    imu_messages,
    resting,
    write_log,
)

SECOND = 10**9
N = 2400
MILLISECOND = 1_000_000


class Rows:
    """A clean log: 3 s of rest, then a hand; each test spoils one thing."""

    def __init__(self):
        self.gyro, self.accel, self.attitude = handheld(N, rest_s=3.0, seed=8)
        self.times = even_times(N)
        self.log = self.times + 2 * MILLISECOND
        self.q = np.zeros(4)
        self.covariance = -1.0

    def messages(self):
        return imu_messages(self.times, self.gyro, self.accel, self.log, self.q, self.covariance)


@pytest.fixture
def rows():
    return Rows()


@pytest.fixture
def findings_of(tmp_path):
    """Oddities by kind of a log of the given rows or messages."""

    def find(rows, **options):
        messages = rows.messages() if isinstance(rows, Rows) else rows
        path = write_log(tmp_path / "log.mcap", messages)
        config = InputOptions(**options)
        with open_log(path) as log:
            surveyed = survey(
                log,
                choose_imu(log, None),
                imu_units(config),
                max_gap_s=config.max_gap,
                increments=config.gyro_kind == "increment",
            )
        listed = oddities(surveyed, config)
        kinds = {o.kind: o for o in listed}
        assert len(kinds) == len(listed)  # each is said once
        fatal = [is_fatal(o) for o in listed]
        assert fatal == sorted(fatal, reverse=True)  # the fatal first
        return kinds

    return find


def is_fatal(odd):
    return odd.severity == Severity.FAILED


def test_nothing_is_odd_about_a_clean_log(rows, findings_of):
    assert findings_of(rows) == {}


@pytest.mark.parametrize("start", [0, 37_250_000_000])
def test_clocks_from_zero_or_from_boot_are_legitimate(rows, findings_of, start):
    rows.times = even_times(N, start_ns=start)
    rows.log = rows.times + MILLISECOND
    assert findings_of(rows) == {}


def test_two_clocks(rows, findings_of):
    rows.times = even_times(N, start_ns=0)
    (odd,) = findings_of(rows).values()
    assert (odd.kind, is_fatal(odd)) == ("clock-offset", False)
    assert "+1700000000.002" in odd.text and "stamps are used" in odd.text
    assert " to " not in odd.text  # one number, not the same one twice


def test_bursts_of_log_times_alone(rows, findings_of):
    """Stamps in the order of measurement, log times in steps of a second: sorted by stamp."""
    rows.log = -(-rows.times // SECOND) * SECOND
    (odd,) = findings_of(rows).values()
    assert odd.kind == "clock-wander" and "+0.995" in odd.text


def test_duplicates(rows, findings_of):
    messages = rows.messages()
    messages[500:500] = messages[499:500] * 3
    (odd,) = findings_of(messages).values()
    assert odd.kind == "duplicate-stamps" and "3 samples" in odd.text and "(0 with" in odd.text
    rows.times[700] = rows.times[699]
    odd = findings_of(rows)["duplicate-stamps"]
    assert "1 sample repeats" in odd.text and "(1 with other" in odd.text


def test_backward_stamps(rows, findings_of):
    messages = rows.messages()
    messages[500], messages[503] = messages[503], messages[500]
    odd = findings_of(messages)["backward-stamps"]
    assert "by up to 0.015 s" in odd.text and "put in order" in odd.text


def test_gaps_from_20_ms_to_4797_s(rows, findings_of):
    rows.times[1000:] += 15 * MILLISECOND
    rows.times[2000:] += 4797 * SECOND
    rows.log = rows.times
    (odd,) = findings_of(rows).values()
    assert odd.kind == "gaps"
    assert "2 gaps longer than 15 ms" in odd.text
    assert "the longest 4797 s" in odd.text and "nothing is integrated across" in odd.text


def test_missing_samples(rows, findings_of):
    messages = rows.messages()
    del messages[1000]
    (odd,) = findings_of(messages).values()
    assert odd.kind == "missed-samples" and "at 1 place;" in odd.text


def test_intervals_over_four_decades(rows, findings_of):
    rows.times = (
        T0 + np.arange(N // 10)[:, None] * 50 * MILLISECOND + np.arange(10) * 5_000
    ).ravel()
    rows.log = rows.times
    odd = findings_of(rows)["bursts"]
    assert "--imu-rate" in odd.answer and not is_fatal(odd)


@pytest.mark.parametrize("rate", [99.50, 285.714, 104.36])
def test_rates_that_are_not_round_are_not_odd(rows, findings_of, rate):
    rows.times = even_times(N, rate)
    rows.log = rows.times
    # the motion is now slower or faster than its rates say, which is no matter of time
    assert findings_of(rows) == {}


def test_sample_and_hold(rows, findings_of):
    held = np.arange(N)
    held[np.random.default_rng(0).random(N) < 0.44] -= 1
    rows.gyro, rows.accel = rows.gyro[held], rows.accel[held]
    odd = findings_of(rows)["held"]
    assert "% of the samples repeat" in odd.text


def test_a_rate_that_is_not_that_of_the_stamps_is_reported(findings_of):
    rows = imu_messages(even_times(60, 100.0), *resting(60))
    odd = findings_of(rows, imu_rate=200.0)["other-rate"]
    assert "200 Hz" in odd.text and "100 Hz" in odd.text and "0.5 times" in odd.text
    assert "other-rate" not in findings_of(rows, imu_rate=101.0)
    assert "other-rate" not in findings_of(rows)


@pytest.mark.parametrize(
    ("rate", "pace", "severity"),
    [
        (1e6, 1.0, Severity.LOST),
        (50.0, 1.0, Severity.LOST),
        (0.005, 1.0, Severity.LOST),
        # half of the samples may not be in the log
        (200.0, 1.0, Severity.WARNING),
        # of stamps that are not of the recorder's time nobody knows
        (50.0, 2.0, Severity.WARNING),
    ],
)
def test_a_rate_that_two_clocks_deny_is_not_to_be_trusted(findings_of, rate, pace, severity):
    """It was ten thousand times the true one, and the status was 0."""
    times = even_times(600, 100.0)
    log_ns = times[0] + ((times - times[0]) * pace).astype(np.int64)
    rows = imu_messages(times, *resting(600), log_ns=log_ns)
    odd = findings_of(rows, imu_rate=rate)["other-rate"]
    assert odd.severity is severity
    assert ("do not trust" in odd.text) == (severity is Severity.LOST)


@pytest.mark.parametrize("rate", [1.0, 4.0, 9.0])
def test_slow_topics_are_refused(findings_of, rate):
    times = even_times(60, rate)
    gyro, accel = resting(60)
    odd = findings_of(imu_messages(times, gyro, accel))["slow-imu"]
    assert is_fatal(odd) and f"{rate:.3g} samples a second" in odd.text
    assert "--imu-topic" in odd.answer and "--imu-rate" in odd.answer
    assert "slow-imu" not in findings_of(imu_messages(times, gyro, accel), imu_rate=100.0)


@pytest.mark.parametrize("max_gap", [1e-4, 0.009])
def test_gaps_shorter_than_the_interval_are_refused(findings_of, max_gap):
    """Nothing would be left to integrate, nor two samples in a row to measure noise with."""
    rows = imu_messages(even_times(60, 100.0), *resting(60))
    odd = findings_of(rows, max_gap=max_gap)["short-max-gap"]
    assert is_fatal(odd) and "10 ms apart" in odd.text and f"--max-gap {max_gap:g}" in odd.text
    assert "short-max-gap" not in findings_of(rows, max_gap=0.01)


def test_deg_s(rows, findings_of):
    rows.gyro *= 180.0 / np.pi
    odd = findings_of(rows)["gyro-unit"]
    assert is_fatal(odd) and "deg/s" in odd.text and "--gyro-unit deg/s" in odd.answer
    assert "differs from gravity by" in odd.text
    assert findings_of(rows, gyro_unit="deg/s") == {}
    answer = findings_of(rows, gyro_unit="rad/s")["gyro-unit"]
    assert not is_fatal(answer) and "read as rad/s as specified" in answer.text


@pytest.mark.parametrize(("size", "fatal"), [(0.5, False), (5.0, True)])
def test_deg_s_that_would_be_usual_rates_in_rad_s_are_questioned_and_not_refused(
    findings_of, size, fatal
):
    """A thrust that stays on its own axis looks like deg/s; 0.5 rad/s are usual, 5 are not."""
    gyro, accel = resting(8000)
    gyro[:, 0] += size * np.sin(0.1 * np.pi * np.arange(8000) / 200.0)
    odd = findings_of(imu_messages(even_times(8000), gyro, accel))["gyro-unit"]
    assert is_fatal(odd) is fatal
    assert ("they are read as rad/s" in odd.text) is not fatal
    assert "add --gyro-unit deg/s" in odd.answer


def test_gyros_that_saturate_where_none_does_in_deg_s_are_in_rad_s(findings_of):
    """Flips of an acrobatic drone beyond 450 deg/s; what a gyro cuts off keeps no gravity."""
    gyro, accel = resting(12_000)
    bell = (2.0 * np.pi / 0.6) * (1.0 - np.cos(2.0 * np.pi * np.arange(120) / 120.0))
    for k, first in enumerate(range(400, 11_600, 800)):
        gyro[first : first + 120, k % 2] += bell
    times = even_times(len(gyro))
    odd = findings_of(imu_messages(times, np.clip(gyro, -7.854, 7.854), accel))["gyro-unit"]
    assert not is_fatal(odd) and "saturate at 7.85" in odd.text
    # in deg/s it would be far beyond
    degrees = np.clip(gyro, -7.854, 7.854) * 180.0 / np.pi
    assert is_fatal(findings_of(imu_messages(times, degrees, accel))["gyro-unit"])


@pytest.mark.parametrize(("rate", "told"), [(0.7, False), (40.0, True)])
def test_a_spin_about_the_vertical_whose_unit_nothing_shows_is_questioned(findings_of, rate, told):
    gyro, accel = resting(8000)
    gyro[400:, 2] += rate
    rows = imu_messages(even_times(8000), gyro, accel)
    findings = findings_of(rows)
    assert ("gyro-unit" in findings) is told
    if told:
        assert not is_fatal(findings["gyro-unit"])
        assert "shows as little" in findings["gyro-unit"].text
    assert "gyro-unit" not in findings_of(rows, gyro_unit="rad/s")


def test_rates_too_large_for_rad_s_say_so(findings_of):
    gyro, accel = resting(1000)
    gyro[100:900, 2] = 400.0  # a turntable in deg/s: gravity does not turn
    odd = findings_of(imu_messages(even_times(1000), gyro, accel))["gyro-unit"]
    assert is_fatal(odd) and "reach 400" in odd.text


def test_g(rows, findings_of):
    rows.accel /= G
    odd = findings_of(rows)["accel-unit"]
    assert is_fatal(odd) and "--accel-unit g" in odd.answer and "1.00" in odd.text
    assert findings_of(rows, accel_unit="g") == {}
    answer = findings_of(rows, accel_unit="m/s^2")["accel-unit"]
    assert not is_fatal(answer) and "as specified" in answer.text


@pytest.mark.parametrize("factor", [1e3 / G, 100.0])
def test_mg_and_cm_s2_are_refused(rows, findings_of, factor):
    rows.accel *= factor
    odd = findings_of(rows)["accel-unit"]
    assert is_fatal(odd) and "mg or cm/s^2" in odd.text
    assert "accel-unit" not in findings_of(rows, accel_unit="m/s^2")


def test_both_units_wrong_are_both_named(rows, findings_of):
    rows.accel /= G
    rows.gyro *= 180.0 / np.pi
    kinds = findings_of(rows)
    assert is_fatal(kinds["gyro-unit"]) and (kinds["accel-unit"].severity == Severity.FAILED)
    assert findings_of(rows, gyro_unit="deg/s", accel_unit="g") == {}


def test_a_topic_of_zeros_is_refused(rows, findings_of):
    rows.gyro, rows.accel = np.zeros((N, 3)), np.zeros((N, 3))
    odd = findings_of(rows)["all-zero"]
    assert is_fatal(odd) and "--imu-topic" in odd.answer


def test_gravity_taken_out(rows, findings_of):
    rows.accel = 0.05 * np.random.default_rng(0).standard_normal((N, 3))
    odd = findings_of(rows)["no-gravity"]
    assert not is_fatal(odd) and "--align log" in odd.answer


@pytest.mark.parametrize("moving", [0.5, 0.8])
def test_gravity_taken_out_of_a_vehicle_that_mostly_moves(rows, findings_of, moving):
    """Its own acceleration is as large as gravity in g, which a rest shows to be missing."""
    random, first = np.random.default_rng(0), round((1.0 - moving) * N)
    rows.accel = 0.02 * random.standard_normal((N, 3))
    rows.accel[first:, 0] += 1.1 * np.sign(np.sin(np.arange(N - first) / 100.0))
    rows.gyro[first:] += 0.3 * random.standard_normal((N - first, 3))
    found = findings_of(rows)
    assert "accel-unit" not in found
    assert "removed gravity" in found["no-gravity"].text


@pytest.mark.parametrize("factor", [0.3, 0.6, 1.5])
def test_odd_sizes_of_gravity(rows, findings_of, factor):
    rows.accel *= factor
    assert f"mostly {factor * G:.2f}"[:-1] in findings_of(rows)["gravity-size"].text


@pytest.mark.parametrize("size", [9.5, 9.78, 10.0])
def test_accelerometers_are_a_little_off(rows, findings_of, size):
    rows.accel *= size / G
    assert findings_of(rows) == {}


TURNS = {
    "+z": Rotation.identity(),
    "-z": Rotation.from_euler("x", 180, degrees=True),
    "+x": Rotation.from_euler("y", -90, degrees=True).inv(),
    "-x": Rotation.from_euler("y", 90, degrees=True).inv(),
    "+y": Rotation.from_euler("x", -90, degrees=True),
    "-y": Rotation.from_euler("x", 90, degrees=True),
}


@pytest.mark.parametrize("axis", TURNS)
def test_gravity_on_any_axis_and_of_either_sign(rows, findings_of, axis):
    sign, letter = axis
    k = "xyz".index(letter)
    turn = TURNS[axis]
    rows.gyro, rows.accel = turn.apply(rows.gyro), turn.apply(rows.accel)
    assert (rows.accel[:500, k] * (1 if sign == "+" else -1)).mean() > 9.0  # as the name says
    kinds = findings_of(rows)
    if axis == "+z":
        assert kinds == {}
    else:
        assert set(kinds) == {"gravity-axis"}
        assert f"gravity on {axis} of the sensor, not on +z" in kinds["gravity-axis"].text
    kinds = findings_of(rows, body_axes="frd")
    assert set(kinds) == (set() if axis == "-z" else {"gravity-axis"})


def test_gravity_between_axes_has_none():
    assert gravity_axis(np.array([5.0, 5.0, 6.0]), "frd") == ""
    assert gravity_axis(np.zeros(3), "frd") == ""
    assert gravity_axis(np.array([0.0, 0.0, -9.8]), "flu") == "+z"
    assert gravity_axis(np.array([0.0, 9.8, 1.0]), "flu") == "-y"


def test_a_large_bias_is_not_motion(rows, findings_of):
    rows.gyro += np.radians([0.0, 0.0, 4.4])
    assert findings_of(rows) == {}
    rows.accel = TURNS["+x"].apply(rows.accel)
    assert set(findings_of(rows)) == {"gravity-axis"}  # so the rest was found all the same


def test_saturation(rows, findings_of):
    limit = 0.8 * np.abs(rows.gyro[:, 0]).max()
    rows.gyro[:, 0] = np.clip(rows.gyro[:, 0], -limit, limit)
    (odd,) = findings_of(rows).values()
    assert odd.kind == "saturation" and odd.text.startswith("gyro x stays")


def test_nan_and_malformed_rows(rows, findings_of):
    rows.gyro[100] = np.nan
    rows.accel[200, 1] = np.inf
    messages = rows.messages()
    messages[300] = messages[300]._replace(message=b"\x00\x01\x00\x00???")
    kinds = findings_of(messages)
    assert set(kinds) == {"not-finite", "malformed", "missed-samples"}
    assert "2 samples" in kinds["not-finite"].text
    assert "1 message does not fit" in kinds["malformed"].text


def test_stamps_all_zero(rows, findings_of):
    rows.times = np.zeros(N, int)
    (odd,) = findings_of(rows).values()
    assert odd.kind == "time-source"
    assert "all header stamps are 0 ns" in odd.text and "log times are used" in odd.text


@pytest.mark.parametrize("back_s", [3600, 3])
def test_a_clock_set_back(rows, findings_of, back_s):
    rows.times[2000:] -= back_s * SECOND + 1_300_000
    (odd,) = findings_of(rows).values()
    assert odd.kind == "time-source" and "back" in odd.text


def test_samples_that_come_too_late(rows, findings_of):
    """Neither clock is in order, further than can be put in place."""
    rows.times = np.zeros(N, int)
    rows.log[:1000] += 3600 * SECOND
    kinds = findings_of(rows)
    assert "time-source" in kinds
    assert f"{N - 1000} samples came too late" in kinds["late-samples"].text


def test_one_sample(findings_of):
    (odd,) = findings_of(imu_messages(T0 + np.zeros(1, int), [0.0, 0, 0], [0.0, 0, G])).values()
    assert odd.kind == "one-sample"


def test_orientations(rows, findings_of):
    rows.covariance = 0.0
    rows.q = rows.attitude.as_quat()
    rows.q[1::2] *= -1.0  # signs flip between samples
    assert findings_of(rows) == {}
    rows.covariance = np.full(9, -1.0)
    rows.q = np.array([0.0, 0.0, 0.0, 1.0])
    assert findings_of(rows) == {}
    rows.covariance = 0.0
    (odd,) = findings_of(rows).values()
    assert odd.kind == "constant-orientation" and "placeholder" in odd.text


def test_orientation_in_another_order(rows, findings_of):
    """w, x, y, z in the fields x, y, z, w."""
    rows.covariance = 0.0
    heading = Rotation.from_euler("z", 70, degrees=True)
    rows.q = np.roll((heading * rows.attitude).as_quat(), 1, axis=1)
    odd = findings_of(rows)["orientation-tilt"]
    assert "order" in odd.text and "not used" in odd.text


@pytest.mark.parametrize("kind", ["mean-rate", "increment"])
def test_other_kinds_of_gyro(rows, findings_of, kind):
    if kind == "increment":
        rows.gyro, rows.accel = rows.gyro * 0.005, rows.accel * 0.005
        odd = findings_of(rows)["increments"]  # read as what they are not
        assert (
            is_fatal(odd)
            and "or 9.90 if samples are increments" in odd.text
            and "--gyro-kind increment" in odd.answer
        )
        assert findings_of(rows, accel_unit="m/s^2")["no-gravity"]
        assert "increments" not in findings_of(rows, imu_rate=100.0)
    assert findings_of(rows, gyro_kind=kind) == {}


def test_rates_read_as_increments_are_refused_with_the_option_that_is_wrong(rows, findings_of):
    odd = findings_of(rows, gyro_kind="increment")["no-increments"]
    assert is_fatal(odd) and "--gyro-kind" in odd.answer and "or 9." in odd.text
    insisted = findings_of(rows, gyro_kind="increment", accel_unit="m/s^2")
    assert "gravity-size" in insisted and not is_fatal(insisted["no-increments"])
    # nor is another unit of the rates the answer, fast as they seem
    rows.gyro = 5.0 * rows.gyro
    for unit in (None, "m/s^2"):
        said = findings_of(rows, gyro_kind="increment", accel_unit=unit)
        assert "gyro-unit" not in said and "--gyro-kind" in said["no-increments"].answer


def test_rates_at_100_hz_read_as_increments_look_like_another_unit(rows, findings_of):
    """982 m/s^2 was taken for cm/s^2, and the log was to be converted."""
    rows.times = rows.times[0] + 2 * (rows.times - rows.times[0])
    rows.log = rows.times
    said = findings_of(rows, gyro_kind="increment")
    assert "accel-unit" not in said and is_fatal(said["no-increments"])


@pytest.mark.parametrize(("axes", "sign"), [("flu", -1.0), ("frd", 1.0)])
def test_gravity_in_the_mean_of_a_log_in_motion_shows_its_axes(rows, findings_of, axes, sign):
    random = np.random.default_rng(4)
    rows.gyro = 0.2 * random.standard_normal((N, 3))
    rows.accel = np.array([0.0, 0.0, sign * 9.81]) + random.standard_normal((N, 3))
    odd = findings_of(rows, body_axes=axes)["gravity-axis"]
    other = "frd" if axes == "flu" else "flu"
    assert "mean of the log" in odd.text and f"--body-axes {other}" in odd.answer
    assert findings_of(rows, body_axes=other) == {}


def test_a_frame_that_ends_in_frd_is_a_hint(rows, findings_of):
    messages = imu_messages(rows.times, rows.gyro, rows.accel, rows.log, frame="base_link_frd")
    odd = findings_of(messages)["frame-axes"]
    assert "base_link_frd" in odd.text and "--body-axes frd" in odd.answer
    turned = imu_messages(rows.times, rows.gyro, -rows.accel, rows.log, frame="base_link_frd")
    assert findings_of(turned)["gravity-axis"].answer.startswith("add --body-axes frd")
    assert findings_of(turned, body_axes="frd") == {}


def test_an_oddity_reads_as_a_sentence_with_its_answer(tmp_path):
    path = imu_log(tmp_path / "a.mcap", even_times(60, 1.0), *resting(60))
    with open_log(path) as log:
        surveyed = survey(log, choose_imu(log, None), imu_units(InputOptions()))
    (odd,) = oddities(surveyed, InputOptions())
    assert str(odd) == f"{odd.text}: {odd.answer}"


def test_a_simulated_rest_is_not_held(rows, findings_of):
    """Three seconds without any noise, then a moving hand: nothing is published twice."""
    rows.gyro[:600], rows.accel[:600] = 0.0, [0.0, 0.0, G]
    assert "held" not in findings_of(rows)
    rows.gyro[1::2], rows.accel[1::2] = rows.gyro[::2], rows.accel[::2]
    assert "held" in findings_of(rows)


def test_rates_wrongly_named_deg_s_are_questioned(rows, findings_of):
    """Units that the user names are used, and what the log says against them is reported."""
    odd = findings_of(rows, gyro_unit="deg/s")["gyro-unit"]
    assert not is_fatal(odd) and "read as deg/s as specified, but gravity turns" in odd.text
    assert "seem to be in rad/s" in odd.text and "leave out --gyro-unit" in odd.answer
    rows.gyro *= 180.0 / np.pi
    assert findings_of(rows, gyro_unit="deg/s") == {}


def test_rates_named_deg_s_that_are_tiny_in_motion_are_questioned(findings_of):
    """A multicopter: its lift shows nothing of the rates, but no motion is that slow."""
    times = np.arange(4000) / 200.0
    gyro, accel = resting(4000)
    gyro[:, 0] += 0.5 * np.sin(6.0 * times)
    accel[:, 2] *= 1.0 + 0.2 * np.sin(3.0 * times)
    moving = imu_messages(even_times(4000), gyro, accel)
    odd = findings_of(moving, gyro_unit="deg/s")["gyro-unit"]
    assert "never exceed 0.51 deg/s in a log that moves" in odd.text
    still = imu_messages(even_times(4000), *resting(4000))
    assert "gyro-unit" not in findings_of(still, gyro_unit="deg/s")


def test_vibration_and_long_turns_are_no_odd_size_of_gravity(rows, findings_of):
    """13.7 m/s^2 in the median of samples, of which the means are gravity; a turn of 50 deg."""
    t = np.arange(N) / 100.0
    rows.accel[:, 0] += 16.0 * np.sign(np.sin(2.0 * np.pi * 23.0 * t))
    assert "gravity-size" not in findings_of(rows)
    rows.accel[:, 0] -= 16.0 * np.sign(np.sin(2.0 * np.pi * 23.0 * t))
    bank, speed = np.deg2rad(50.0), 20.0
    turn = G * np.tan(bank) / speed
    rows.gyro = np.tile([0.0, -turn * np.sin(bank), turn * np.cos(bank)], (N, 1))
    rows.accel = np.tile([0.0, 0.0, G / np.cos(bank)], (N, 1))
    assert "gravity-size" not in findings_of(rows)


@pytest.mark.parametrize("unit", [1.0, 1.0 / G], ids=["m/s^2", "g"])
def test_a_rocket_that_falls_is_not_in_units_of_g(rows, findings_of, unit):
    """What it feels most of the time is the air alone, and about 1 m/s^2; it rests before."""
    rows.accel[400:600] *= 4.0
    rows.accel[600:] *= 0.1
    rows.accel *= unit
    questioned = {"accel-unit", "gravity-size", "no-gravity"} & set(findings_of(rows))
    assert bool(questioned) == (unit != 1.0)
