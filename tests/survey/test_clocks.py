"""A receiver that stamps by another clock than the IMU is found, and its stamps can be moved."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.load import build
from sinstool.core.streams import GnssEpochs
from sinstool.io.readers import open_log
from sinstool.survey.clocks import clocks_apart
from sinstool.survey.gnss import read_gnss
from sinstool.survey.source import prepare
from tests.helpers.imulogs import T0, even_times, header, imu_messages, write_log
from tests.survey.test_aiding import fix_message, twist_message

N = 60
TIMES = even_times(N, rate=2.0)


def survey(low=0.0, high=0.01, time_source="stamp"):
    return SimpleNamespace(clock_offset_s=(low, high), time_source=time_source)


def epochs(ahead_s, delay=0.1, n=N):
    """Fixes whose stamps are ahead, recorded after a delay."""
    logged = T0 + np.arange(n) * 500_000_000
    late = np.full(n, delay) if np.isscalar(delay) else delay
    stamps = logged + np.round((ahead_s - late) * 1e9).astype(np.int64)
    none = np.full((n, 3), np.nan)
    return GnssEpochs(stamps, logged, np.zeros(n), np.zeros(n), np.zeros(n), none, none, none)


@pytest.mark.parametrize("ahead", [18.0, -18.0, 3600.0, 1.7e9])
@pytest.mark.parametrize("imu", [0.0, -5.0])
def test_two_clocks_are_named_with_the_option(ahead, imu):
    (finding,) = clocks_apart(survey(imu, imu + 0.2), epochs(ahead - imu), "/fix", InputOptions())
    assert finding.kind == "receiver-clock" and finding.topic == "/fix"
    assert finding.numbers["ahead_s"] == pytest.approx(ahead, abs=0.2)
    assert ("ahead of" if ahead > 0 else "behind") in finding.text
    assert ("recorded that late" in finding.answer) == (ahead < 0)
    shown = float(finding.answer.split("--gnss-clock-offset ")[1].split(",")[0])
    assert shown == pytest.approx(ahead, abs=0.2)


def test_the_option_named_is_the_one_to_give_whatever_was_given():
    given = InputOptions(gnss_clock_offset=-2.0)
    (finding,) = clocks_apart(survey(0.0, 0.2), epochs(20.0), "/fix", given)
    shown = float(finding.answer.split("--gnss-clock-offset ")[1])
    assert shown == pytest.approx(18.0, abs=0.2)
    (finding,) = clocks_apart(survey(0.1, 0.2), epochs(2.0), "/fix", given)
    assert finding.answer == "leave --gnss-clock-offset out"


def test_one_clock_says_nothing():
    assert not clocks_apart(survey(), epochs(0.0), "/fix", InputOptions())
    assert not clocks_apart(survey(), epochs(0.3, delay=0.05), "/fix", InputOptions())
    # a receiver that delivers late, now and then by much
    late = np.random.default_rng(1).exponential(3.0, N)
    assert not clocks_apart(survey(), epochs(0.0, delay=late), "/fix", InputOptions())
    # an IMU whose recorder hangs, or whose clock is set in the log
    assert not clocks_apart(survey(0.0, 40.0), epochs(0.0, delay=20.0), "/fix", InputOptions())


def test_nothing_to_judge_by():
    assert not clocks_apart(survey(time_source="log"), epochs(18.0), "/fix", InputOptions())
    assert not clocks_apart(survey(), epochs(18.0, n=2), "/fix", InputOptions())
    assert not clocks_apart(survey(), None, "", InputOptions())


def stamped_ahead(ahead_s):
    """Fixes and velocities of a receiver whose clock is ahead, and an IMU at rest."""
    messages = imu_messages(
        even_times(600, rate=20.0), np.zeros((600, 3)), np.tile([0.0, 0.0, 9.8], (600, 1))
    )
    for k, time_ns in enumerate(TIMES):
        stamp = int(time_ns) + round(ahead_s * 1e9)
        for message in (
            fix_message(k, time_ns, 48.0, 11.0),
            twist_message(time_ns, (0.0, 0.0, 0.0), 0.01),
        ):
            message.message.header = header(stamp, "gnss")
            messages.append(message)
    return sorted(messages, key=lambda m: m.log_ns)


def test_stamps_of_fixes_and_velocities_are_moved(tmp_path):
    path = write_log(tmp_path / "a.mcap", stamped_ahead(18.0))
    with open_log(path) as log:
        gnss = read_gnss(log, InputOptions(gnss_clock_offset=18.0), False).gnss
        np.testing.assert_array_equal(gnss.time_ns, TIMES)
        assert gnss.has_position.all() and gnss.has_velocity.all()
        first = read_gnss(log, InputOptions(gnss_clock_offset=18.0), False, int(TIMES[9])).gnss
        assert TIMES[9] <= first.time_ns[-1]
        # by the recorder's times there is one clock
        by_log = read_gnss(log, InputOptions(gnss_clock_offset=18.0), True).gnss
        np.testing.assert_array_equal(by_log.time_ns, TIMES)


@pytest.mark.parametrize(("offset", "found"), [(0.0, True), (18.0, False)])
def test_the_finding_goes_once_the_option_is_given(tmp_path, offset, found):
    path = write_log(tmp_path / "a.mcap", stamped_ahead(18.0))
    config = build(ProcessConfig, {"input": {"gnss_clock_offset": offset}})
    with open_log(path) as log:
        kinds = [f.kind for f in prepare(log, config).findings]
    assert ("receiver-clock" in kinds) == found
