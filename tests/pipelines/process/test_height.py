"""What a run holds its height to: which GNSS heights set a barometer, and what is said of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import ConfigurationError, DataError
from sinstool.core.finding import Severity
from sinstool.core.streams import Baro, GnssEpochs
from sinstool.methods.height.layout import ChannelSummary, Event
from sinstool.methods.height.reference import HeightReference, reference_from_gnss
from sinstool.methods.height.standard_atmosphere import geopotential, pressure_at
from sinstool.pipelines.process.height import (
    height_reference,
    heights_for_calibration,
    network,
)
from sinstool.pipelines.process.height_events import height_warnings, untrusted_heights
from sinstool.survey.aiding import AidingData, Barometer

T0 = 1_700_000_000_000_000_000
LATITUDE = np.radians(-43.5)


def streams(seconds=200.0, jump_at=None, hangs=None, gap=None, climb=2.0, day=1.0):
    t = np.arange(0.0, seconds, 0.1)
    height = 300.0 + climb * t
    shown = height + (0.0 if jump_at is None else 25.0 * (t >= jump_at))
    if hangs is not None:
        inside = (t >= hangs[0]) & (t < hangs[1])
        shown[inside] = shown[inside][0]
    keep = np.ones(len(t), bool) if gap is None else (t < gap[0]) | (t > gap[1])
    times = T0 + np.round(t * 1e9).astype(np.int64)
    pressure = pressure_at(geopotential(shown / day))
    baro = Baro(times[keep], times[keep], pressure[keep], np.zeros(keep.sum()))
    rows = slice(0, None, 10)
    n = len(t[rows])
    nothing = np.full((n, 3), np.nan)
    gnss = GnssEpochs(
        times[rows], times[rows], np.full(n, LATITUDE), np.zeros(n),
        height[rows] + np.random.default_rng(1).normal(0.0, 2.0, n), nothing, nothing, nothing,
    )  # fmt: skip
    return baro, gnss, t[rows]


def test_all_tell_where_nothing_is_wrong():
    baro, gnss, _ = streams()
    assert heights_for_calibration(baro, gnss).all()


def test_none_after_a_jump():
    baro, gnss, t = streams(jump_at=120.0)
    known = heights_for_calibration(baro, gnss)
    assert not known[t >= 121.0].any()
    assert known[t < 117.0].all()


def test_none_in_a_gap():
    baro, gnss, t = streams(gap=(50.0, 90.0))
    np.testing.assert_array_equal(heights_for_calibration(baro, gnss), (t < 50.0) | (t > 90.0))


@pytest.mark.parametrize("day", [0.92, 1.06])
@pytest.mark.parametrize("gap", [(100.0, 250.0), None])
def test_the_scale_of_a_day_in_a_fast_climb_is_no_jump(day, gap):
    baro, gnss, t = streams(seconds=400.0, gap=gap, climb=30.0, day=day)
    known = heights_for_calibration(baro, gnss)
    np.testing.assert_array_equal(known, True if gap is None else (t < 100.0) | (t > 250.0))
    reference = reference_from_gnss(
        baro.time_ns, baro.pressure, gnss.time_ns[known], gnss.height[known]
    )
    assert reference.scale == pytest.approx(day, abs=2e-3)


def test_a_jump_in_a_gap_is_one():
    baro, gnss, t = streams(gap=(100.0, 130.0), jump_at=120.0, climb=0.5)
    known = heights_for_calibration(baro, gnss)
    assert known[t < 97.0].all() and not known[t > 132.0].any()


def test_none_of_a_sensor_that_hangs_in_a_climb():
    baro, gnss, t = streams(hangs=(50.0, 90.0))
    known = heights_for_calibration(baro, gnss)
    assert not known[(t >= 50.0) & (t < 89.5)].any() and known[t < 49.0].all()
    assert known[t > 91.0].all()


def test_a_coarse_sensor_at_rest_tells():
    baro, gnss, _ = streams(climb=0.0)
    assert heights_for_calibration(baro, gnss).all()


def options(**options):
    return build(ProcessConfig, {"vertical": {"height_damping": "baro", **options}})


@pytest.mark.parametrize(
    ("chosen", "grade", "expected"),
    [
        ({}, "mems", (5.0, 0.0)),
        ({}, "tactical", (30.0, 0.0)),
        ({}, "navigation", (100.0, 0.0)),
        ({"height_preset": "paper"}, "mems", (2.4, 0.5)),
        ({"tau": 12.0, "k4": -1.0}, "mems", (12.0, -1.0)),
        ({"baro_lag": 0.8}, "tactical", (30.0, -0.8)),
        ({"height_preset": "paper", "baro_lag": 0.5}, "mems", (2.4, 0.0)),
    ],
)
def test_network_of_a_run(chosen, grade, expected):
    actual, _ = network(options(**chosen), grade, LATITUDE)
    assert (actual.tau, actual.k4) == expected
    assert actual.w2 == pytest.approx(3.084e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("variance", "sigma"), [(16.0, 0.35), (0.0, 0.0), (np.nan, 0.0), (np.inf, 0.0), (1e300, 0.0)]
)
def test_what_a_barometer_says_of_its_noise(variance, sigma):
    """16 Pa^2 are 4 Pa, or 0.35 m at 700 m; what is no noise of any sensor is not told."""
    baro, gnss, _ = streams()
    baro.variance[:] = variance
    aiding = AidingData(gnss=gnss, fix_topic="/fix", barometer=Barometer(baro, "/baro"))
    source = SimpleNamespace(path="a.mcap", aiding=aiding, survey=survey_of())
    reference, warnings = height_reference(source, options(), 300.0)
    assert reference.sigma == pytest.approx(sigma, rel=0.1)
    assert not warnings


def source_of(baro, gnss):
    aiding = AidingData(gnss=gnss, fix_topic="/fix", barometer=Barometer(baro, "/baro"))
    return SimpleNamespace(path="a.mcap", aiding=aiding, survey=survey_of())


def survey_of(rests=()):
    spans = tuple(SimpleNamespace(start_ns=T0 + a * 10**9, end_ns=T0 + b * 10**9) for a, b in rests)
    return SimpleNamespace(first_ns=T0, spans=spans)


def test_a_barometer_that_no_fix_falls_into_is_set_by_the_start():
    """A receiver on another clock must not refuse what the barometer alone can do."""
    baro, gnss, _ = streams()
    later = replace(gnss, time_ns=gnss.time_ns + 7200 * 10**9)
    reference, _ = height_reference(source_of(baro, later), options(), 300.0)
    assert reference.baro.mode == "init"
    assert reference.height[0] == pytest.approx(300.0, abs=1.5)
    with pytest.raises(DataError, match="--baro-ref gnss: the log has no GNSS heights at"):
        height_reference(source_of(baro, later), options(baro_ref="gnss"), 300.0)


@pytest.mark.parametrize("baro_ref", ["auto", "gnss", "init"])
def test_a_unit_that_no_atmosphere_has_is_named(baro_ref):
    baro, gnss, _ = streams()
    spoilt = replace(baro, pressure=100.0 * baro.pressure)
    chosen = {"vertical": {"height_damping": "baro", "baro_ref": baro_ref},
              "input": {"baro_unit": "hPa"}}  # fmt: skip
    with pytest.raises(
        DataError, match=r"read in hPa as configured, which no atmosphere.*--baro-u"
    ):
        height_reference(source_of(spoilt, gnss), build(ProcessConfig, chosen), 300.0)


def test_what_is_said_of_a_network():
    assert not network(options(), "mems", LATITUDE)[1]
    said = network(options(tau=400.0, k4=0.5), "mems", LATITUDE)[1]
    assert "--tau 400 s is outside the sensible 0.5 to 300 s" in said[0]
    assert "-0.5 s times the vertical velocity" in said[1]
    with pytest.raises(ConfigurationError):
        network(options(height_preset="paper", baro_lag=10.0), "mems", LATITUDE)


def channel(**counts):
    return ChannelSummary("engaged", {"accepted": 9, "waiting": 1} | counts, {}, 0.0, 0.0, 1.0)


def test_what_is_said_of_samples_and_events():
    events = [Event("coast", 10.0 * k, 2.0, 0.0) for k in range(1, 6)]
    events += [Event("engaged", 0.0, 0.0, 0.0), Event("jump", 70.0, -12.5, 0.8)]
    said = height_warnings(channel(gate=3, stamp=2, frozen=0), events)
    assert said[0].endswith("3 too far off, 2 whose stamp repeats or goes back")
    assert sum("coasting" in text for text in said) == 3
    assert "... and 2 more events of this kind (coast)" in said
    assert any("jumped by -12.5 m at 70.0 s" in text for text in said)
    assert not height_warnings(channel(), [])
    assert "undamped" in height_warnings(channel(accepted=0), [])[0]


def test_a_gap_of_the_imu_is_no_fault_of_the_height_reference():
    gap = Event("imu-gap", 92.0, 2.0, 0.0)
    ends = [Event("coast", 92.01, 0.0, 0.0), Event("re-engaged", 92.1, -3.1, 0.09)]
    said = height_warnings(channel(), [gap, *ends])
    assert said == [
        "the IMU has a gap of 2.00 s until 92.0 s; height is carried over it",
        "after gaps of the IMU height differed from its reference by -3.1 m",
    ]
    silent = [Event("coast", 92.01, 0.0, 0.0), Event("re-engaged", 99.0, -3.1, 7.0)]
    assert "coasting" in height_warnings(channel(), [gap, *silent])[1]
    assert "coasting" in height_warnings(channel(), ends)[0]


def test_a_coast_begins_with_the_last_good_sample():
    """It was told 2 s late, and its length counted from there."""
    events = [Event("coast", 52.0, 2.0, 0.0), Event("re-engaged", 90.0, 4.0, 38.0)]
    first, second = height_warnings(channel(), events, 100.0)
    assert first == "no good height reference from 150.0 s on; coasting"
    assert "good again at 190.0 s, after 40.0 s" in second


ENGAGED = Event("engaged", 0.0, 0.0, 0.0)
COAST = [ENGAGED, Event("coast", 52.0, 2.0, 0.0)]
UNTRUSTED = {
    "near": ([*COAST, Event("re-engaged", 90.0, 14.0, 38.0)], []),
    "far": ([*COAST, Event("re-engaged", 90.0, -261.0, 38.0)], [(50.0, 90.0, -261.0)]),
    "disturbed": (
        [*COAST, Event("re-engaged", 90.0, 14.0, 38.0), Event("returned", 150.0, -40.0, 1.0)],
        [(90.0, 150.0, 40.0)],
    ),
    "frozen": (
        [Event("frozen", 80.0, 60.0, 30.0), Event("re-engaged", 90.0, 2.0, 10.0)],
        [(50.0, 90.0, -60.0)],
    ),
    "jump": ([ENGAGED, Event("jump", 60.0, 100.0, 0.8)], []),
    "a short end": (COAST, []),
    "a long end": ([ENGAGED, Event("coast", 12.0, 2.0, 0.0)], [(10.0, 400.0, None)]),
}


@pytest.mark.parametrize("case", UNTRUSTED)
def test_heights_that_were_far_off_are_lost(case):
    """A coast of 40 s ended 261 m off, with status 0."""
    events, expected = UNTRUSTED[case]
    length = 320.0 if case == "a short end" else 400.0
    found = untrusted_heights(events, T0, 7.0, length, 0.0)
    assert all(one.severity is Severity.LOST for one in found)
    spans = [
        ((f.start_ns - T0) / 1e9, (f.end_ns - T0) / 1e9, f.numbers.get("off_m")) for f in found
    ]
    assert spans == expected
    for one, (begin, end, _) in zip(found, expected, strict=True):
        to = "on" if end == length else f"to {end + 7.0:.1f} s"
        assert one.text.startswith(f"height from {begin + 7.0:.1f} s {to} is not to be trusted")
    # A reference of such a sigma shows less
    assert not [f for f in untrusted_heights(events, T0, 7.0, length, 100.0) if f.numbers]


def test_the_first_height_is_that_of_the_first_second():
    times = T0 + np.array([0, 5, 9, 40]) * 10**8
    heights = np.array([np.nan, 120.0, 124.0, 500.0])
    reason = np.array([1, 0, 0, 0])
    reference = HeightReference("baro", "/altitude", times, heights, reason, 0.0, None)
    assert reference.first_height == 122.0
    none = replace(reference, reason=np.ones(4, np.int64))
    assert none.first_height == 0.0
