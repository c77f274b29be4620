"""Long gaps of the IMU, and sensors worse than their noise at rest: found anew, or found worse."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trusted_navigation import process, read_back
from sinstool.config import ProcessConfig
from sinstool.io.readers import open_log
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.pipelines.planning import make_plan
from sinstool.pipelines.process.ins_gnss.before_start import before_start_text
from sinstool.pipelines.process.ins_gnss.between_gaps import gap_findings, start_in_longest
from sinstool.survey.source import prepare
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    drive,
    flight,
    multicopter,
    record,
    without_fixes,
    without_samples,
    write,
)
from tests.helpers.unseen_errors import shaken
from tests.helpers.unseen_vehicles import train

ARM = ",".join(str(x) for x in LEVER)


def level(answer):
    """Horizontal error, m, and over its sigma."""
    error = np.hypot(answer.error[:, 0], answer.error[:, 1])
    return error, error / np.hypot(answer.sigma[:, 0], answer.sigma[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--smooth"]], ids=["filter", "smoother"])
@pytest.mark.parametrize("begin, length", [(150.0, 60.0), (120.0, 300.0)])
def test_after_a_long_gap_attitude_is_found_from_what_follows(tmp_path, options, begin, length):
    """6.7 km off before, with sigmas that were no numbers."""
    truth = drive(seed=4, duration=begin + length + 150.0, rest=60.0)
    data = without_samples(record(truth, GRADES["tactical"], 4), begin, length)
    log = write(tmp_path / "gap.mcap", data)
    answer, status, _ = process(log, truth, options)
    assert status == 0
    error, sigmas = level(answer)
    after = answer.seconds > begin + length + 0.5
    # Right from the gap's end on: what lies before the new start is carried back
    assert answer.seconds[after][0] < begin + length + 1.0
    assert error[after].max() < 1.0
    assert sigmas[after].max() < 5.0
    assert np.sqrt(np.mean(np.square(sigmas[after]))) < 2.0


@pytest.mark.slow
def test_what_precedes_a_gap_is_not_lost_as_more_is_known_beyond_it(tmp_path):
    """No solution before, and words that said there was one."""
    begin, length = 110.0, 30.0
    truth = drive(seed=41, duration=400.0, rest=20.0)
    data = without_samples(record(truth, GRADES["tactical"], 1, sigma=0.5), begin, length)
    log = write(tmp_path / "gap.mcap", data)
    answer, status, _ = process(log, truth, [])
    assert status == 0
    error, sigmas = level(answer)
    for part in (answer.seconds < begin, answer.seconds > begin + length + 0.5):
        assert part.sum() > 1000
        assert error[part].max() < 3.0 and sigmas[part].max() < 4.0


@pytest.mark.slow
def test_what_precedes_a_short_gap_is_not_lost_either(tmp_path):
    """A start behind 0.4 s without samples, which a filter bridges, left 100 s without solution."""
    truth = multicopter(seed=3, duration=300.0)
    data = without_samples(record(truth, GRADES["industrial"], 1, sigma=0.5), 100.0, 0.4)
    answer, status, _ = process(write(tmp_path / "gap.mcap", data), truth, [])
    assert status == 0 and answer.seconds[0] < 1.0
    error, sigmas = level(answer)
    assert error.max() < 6.0 and sigmas.max() < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("every, seed", [(10.0, 4), (15.0, 7)])
def test_a_start_is_carried_back_over_many_short_gaps(tmp_path, every, seed):
    """No stretch was long enough to show an attitude but one after seven minutes: no solution.

    Tilts were 0.2 rad off beside gaps, by 20 of their sigmas: a multicopter leans this way and that
    in them, and the smoother was linear across.
    """
    truth = multicopter(seed=seed, duration=450.0)
    data = record(truth, GRADES["industrial"], 1, sigma=0.5)
    for begin in np.arange(every, 400.0, every):
        data = without_samples(data, begin, 0.4)
    answer, status, _ = process(write(tmp_path / "gap.mcap", data), truth, ["--smooth"])
    assert status == 0 and answer.seconds[0] < 1.0
    spread = np.sqrt(np.mean(np.square(answer.error / answer.sigma), axis=0))
    assert spread.max() < 1.7 and spread.min() > 0.2
    assert np.abs(answer.error[:, 6:8]).max() < 0.15


@pytest.mark.parametrize("length", [0.4, 30.0])
def test_which_gaps_a_filter_bridges_is_said(tmp_path, length):
    """ "Nothing is integrated across it" was said of 0.4 s, too."""
    data = without_samples(record(drive(1, 90.0, 5.0), GRADES["industrial"], 1), 30.0, length)
    with open_log(write(tmp_path / "gap.mcap", data)) as opened:
        survey = prepare(opened, ProcessConfig(), None).survey
    (finding,) = gap_findings(survey, Settings())
    bridged = finding.text.endswith("short enough to be integrated across")
    assert bridged == (length < 5.0)
    assert bridged != ("nothing is integrated across" in finding.text)


@pytest.mark.slow
def test_a_start_soon_before_a_gap_gives_way_to_one_in_the_longest_stretch(tmp_path):
    """From there nothing showed latency, noise and drift: tilts were 7 sigmas off in one log."""
    truth = drive(seed=47, duration=420.0, rest=20.0)
    data = record(truth, GRADES["industrial"], 3, gnss_rate=2.0, sigma_v=0.07)
    log = write(tmp_path / "gap.mcap", without_samples(data, 100.0, 30.0))
    options = {"gyro_kind": "mean-rate", "gyro_unit": "rad/s"}

    def first(**more):
        config = ProcessConfig(navigation={"mode": "ins-gnss"}, input=options, **more)
        with open_log(log) as opened:
            source = prepare(opened, config, None)
            begun = make_plan(source, config).filter_start
            if not more:
                begun = replace(begun, start=early.start, time_ns=early.time_ns)
                begun = start_in_longest(source, config, begun)
        return begun, (begun.time_ns - T0) * 1e-9

    early, seconds = first(in_flight={"align_end": 90.0})
    assert seconds < 90.0  # options that say where to align are obeyed
    late, seconds = first()
    assert seconds > 130.0 and not np.array_equal(late.start.nav, early.start.nav)


def test_words_about_the_time_before_a_start():
    assert before_start_text(0.0, 3.0).startswith("the first 3.00 s lie before the filter's start:")
    assert before_start_text(80.0, 80.0).endswith("and have no solution")
    both = before_start_text(80.0, 92.5)
    assert "the first 80.00 s" in both and "the 12.50 s that follow" in both


@pytest.mark.slow
def test_fixes_that_return_after_the_imu_show_the_attitude_after_a_gap(tmp_path):
    """140 m off at 39 sigmas before: a start was looked for where there were no fixes yet."""
    truth = flight(seed=6, duration=300.0, turbulent=True)
    data = without_samples(record(truth, GRADES["tactical"], 6), 110.0, 80.0)
    log = write(tmp_path / "gap.mcap", without_fixes(data, [(130.0, 205.0)]))
    answer, status, _ = process(log, truth, ["--smooth"])
    assert status == 0
    error, sigmas = level(answer)
    blind = (answer.seconds > 190.5) & (answer.seconds < 205.0)
    assert blind.sum() > 100
    assert error[blind].max() < 30.0
    assert sigmas[blind].max() < 4.0
    assert error[answer.seconds > 207.0].max() < 1.0


@pytest.mark.slow
def test_the_only_attitude_of_a_log_may_hold_before_fixes_return(tmp_path):
    """Refused before, as no fix lay within 2 s of where the attitude held."""
    truth = drive(seed=7, duration=300.0, rest=120.0)
    data = record(truth, GRADES["tactical"], 7, gnss_rate=2.0, sigma=0.3)
    data = without_fixes(without_samples(data, 102.0, 41.0), [(83.0, 199.0)])
    answer, _, note = process(write(tmp_path / "log.mcap", data), truth, [])
    assert answer is not None, note
    error, sigmas = level(answer)
    late = answer.seconds > 205.0
    assert late.sum() > 500 and error[late].max() < 3.0 and sigmas[late].max() < 4.0


@pytest.mark.slow
def test_a_gap_of_some_seconds_needs_a_new_start_too(tmp_path):
    """While the train stood, the filter learnt a heading that was 45 deg off from gravity."""
    truth = train(3, 260.0)
    data = record(truth, GRADES["tactical"], 3, gnss_rate=2.0, sigma=0.1, sigma_v=0.042)
    log = write(tmp_path / "gap.mcap", without_samples(data, 150.0, 7.1))
    answer, status, _ = process(log, truth, [])
    assert status == 0
    after = answer.seconds > 158.0
    assert np.abs(answer.error[after, 8]).max() < 5.0 * np.pi / 180.0
    sigmas = answer.error[after, 6:] / answer.sigma[after, 6:]
    assert np.all(np.sqrt(np.mean(np.square(sigmas), axis=0)) < 1.5)


@pytest.mark.slow
def test_innovations_refute_a_grade_that_quiet_gyros_suggest(tmp_path, sinstool):
    """An industrial IMU that never rests has a tactical one's white noise: 468 m off before."""
    truth = flight(seed=2, duration=300.0)
    log = write(tmp_path / "flight.mcap", record(truth, GRADES["industrial"], 2))
    out = tmp_path / "out.mcap"
    words = ["--mode", "ins-gnss", "--gyro-kind", "mean-rate", "--lever-arm", ARM, "--json"]
    status, text, _ = sinstool("process", log, "-o", out, *words)
    filter_ = json.loads(text)["filter"]
    assert status == 0
    assert filter_["imu_grade"]["grade"] == "industrial"
    assert filter_["restarts"] == 0
    error, sigmas = level(read_back(out, truth))
    assert error.max() < 1.0
    assert np.sqrt(np.mean(np.square(sigmas))) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 4, 6])
def test_one_sample_beside_a_gap_is_not_how_a_vehicle_turned_in_it(tmp_path, seed):
    """The rate of a sample of 40 deg/s, for 2.8 s: the attitude was off by 122 deg, 13 sigmas."""
    truth = multicopter(seed, 200.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=2.0, sigma=0.2)
    data = without_samples(shaken(data, seed, 2.0, 0.5), 120.0, 3.0)
    answer, *_ = process(write(tmp_path / "gap.mcap", data), truth, ["--lever-arm", ARM])
    after = (answer.seconds > 123.0) & (answer.seconds < 125.0)
    off = np.linalg.norm(answer.error[after, 6:8], axis=1)
    sigma = np.linalg.norm(answer.sigma[after, 6:8], axis=1)
    assert np.rad2deg(off.max()) < 30.0 and (off / sigma).max() < 3.0
