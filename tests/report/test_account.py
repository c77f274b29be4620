"""The paragraphs above the figures of a run: true to its numbers, and in words."""

from types import SimpleNamespace

import pytest

from sinstool.core.english import counted, in_seconds
from sinstool.pipelines.process.travel import Accuracy, Outages, Spread, Travel
from sinstool.report.text.account import account, distance, duration, heading_origin, squares

ACCURACY = Accuracy(Spread(0.25, 0.6), Spread(0.43, 1.1), Spread(4.1, 5.4), Spread(5.43, 8.5))


def choice(value, reason):
    return SimpleNamespace(value=value, reason=reason)


def run(mode="ins-gnss", accuracy=ACCURACY, outages=None, north=True, truth=None):
    plan = SimpleNamespace(
        mode=choice(mode, "as the log has fixes"),
        first_attitude=choice("svd", "attitude by svd from velocity changes"),
        gyro_samples=choice("rate", "the default"),
        imu_grade=choice("mems", "by its noise"),
    )
    navigated = mode == "ins-gnss"
    vehicle = SimpleNamespace(land=None, reason="as it is an aircraft")
    used = SimpleNamespace(epochs_used=2401, epochs_gated=3, outages=outages, vehicle=vehicle)
    way = (5678.3, 9.464, 16.33) if navigated else (None,) * 3
    return SimpleNamespace(
        plan=plan,
        travel=Travel(600.0, *way, accuracy),
        output=SimpleNamespace(attitudes=60001),
        alignment=SimpleNamespace(north_referenced=north),
        filter=used if navigated else None,
        smoothing=None,
        hse=None,
        truth=truth,
    )


def test_navigation_with_outages():
    extent, known, assumed = account(run(outages=Outages(2, 31.0, 20.0)))
    assert extent == (
        "Attitude, velocity and position were computed from the IMU and GNSS: 60001 attitudes over"
        " 10.0 min and 5.68 km over ground, at 9.46 m/s on average and at most 16.3 m/s. 2401 GNSS"
        " epochs were used and 3 rejected, with 2 outages of 31 s in all, the longest of 20 s."
    )
    assert known == (
        "By the run's own estimate, roll and pitch are known to 0.25 deg, heading to 0.43 deg and"
        " position to 4.1 m north and east and 5.4 m in height (one standard deviation, median over"
        " the log)."
    )
    assert assumed == (
        "Assumed and chosen: mode ins-gnss, as the log has fixes; first attitude svd, from velocity"
        " changes; gyro samples rate, the default; IMU grade mems, by its noise; a vehicle that may"
        " slide, as it is an aircraft."
    )


@pytest.mark.parametrize(
    ("outages", "said"),
    [(Outages(0, 0.0, 0.0), "without an outage."), (Outages(1, 5.0, 5.0), "one outage of 5 s.")],
)
def test_few_outages(outages, said):
    assert account(run(outages=outages))[0].endswith(said)


def test_attitude_alone_without_an_accuracy_and_without_north():
    extent, known, _ = account(run("attitude", None, north=False))
    assert extent == "Only attitude was computed, from the IMU: 60001 attitudes over 10.0 min."
    assert "does not estimate" in known and "Nothing in the log shows north" in known


def test_errors_stand_beside_the_sigmas_of_the_run():
    kinds = [("position", "m", SimpleNamespace(rms=(1.234, 2.0, 3.0)))]
    truth = SimpleNamespace(kinds=lambda: kinds, names=("truth.csv",))
    known = account(run(outages=Outages(0, 0.0, 0.0), truth=truth))[1]
    assert "By the run's own estimate" in known
    assert known.endswith(
        "truth.csv the errors (rms; north, east, down) are: position 1.2, 2, 3 m."
    )


def test_innovations_far_from_what_was_expected_are_put_into_words():
    assert "7.1 times better" in squares(0.02) and "too large" in squares(0.02)
    assert "3 times more" in squares(9.0) and "too small" in squares(9.0)
    assert "--gnss-noise-scale" in squares(0.02) and "--gnss-noise-scale" in squares(9.0)
    assert "as the sigmas say" in squares(0.92)


def test_lengths_of_time_and_way():
    assert [duration(s) for s in (20.0, 600.0, 7200.0)] == ["20 s", "10.0 min", "2.00 h"]
    assert [distance(m) for m in (12.34, 999.0, 1000.0)] == ["12.3 m", "999 m", "1.00 km"]


@pytest.mark.parametrize(
    ("refused", "north", "origin"),
    [
        ("", "true", "true north"),
        ("", "magnetic", "magnetic north"),
        ("", "none", "the magnetometer's north, which could not be verified"),
        ("its field is disturbed", "none", ""),
    ],
)
def test_a_magnetometer_shows_north_where_the_first_attitude_does_not(refused, north, origin):
    result = run(mode="attitude", north=False)
    compass = SimpleNamespace(refused=refused, north=north)
    result.smoothing = SimpleNamespace(heading_lost=False, magnetometer=compass)
    assert heading_origin(result) == origin
    assert ("Nothing in the log shows north" in account(result)[1]) == (not origin)


def test_one_of_a_thing_is_not_called_several():
    """`process` and `info` said "1 gaps"."""
    assert [counted(n, "gap") for n in (0, 1, 2)] == ["0 gaps", "1 gap", "2 gaps"]


def test_hours_in_seconds_have_no_power_of_ten():
    """A log of 8 h was "2.88e+04 s" long."""
    assert in_seconds(28799.5) == "28800 s"
    assert in_seconds(0.25004) == "0.25 s" and in_seconds(1234.4, 3) == "1234 s"
    assert in_seconds(2.5512, 3) == "2.55 s"
