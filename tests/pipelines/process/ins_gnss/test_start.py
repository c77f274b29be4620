"""A filter's start, which several runs find out."""

import gc
from dataclasses import replace
from types import FrameType

import pytest

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import GnssEpochs
from sinstool.io.readers import open_log
from sinstool.methods.alignment import in_motion
from sinstool.pipelines.planning import make_plan
from sinstool.pipelines.process.ins_gnss import initial_state, white_noise
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import simulated, start_of
from tests.helpers.unseen_drives import CONSUMER, GRADES, LEVER, cruise, drive, record, write
from tests.helpers.unseen_errors import wandering


@pytest.mark.slow
def test_nothing_is_aligned_and_no_white_noise_sought_twice(tmp_path, monkeypatch):
    """Where its drift gives an IMU another grade all begins anew, but for the first attitude."""
    data = record(drive(1, 400.0, 20.0), GRADES["tactical"], 1, gnss_rate=2.0, sigma=0.4)
    log = write(tmp_path / "log.mcap", wandering(data, 1, 1.6, 100.0))
    aligned, sought = [], []
    in_flight, filter_run = initial_state.in_flight, white_noise.InsGnssFilter

    def aligning(source, config, method, shown, time_ns, later_ns, near):
        grade, latency = config.navigation.imu_grade, config.gnss.gnss_latency
        aligned.append((grade, latency, time_ns, shown.sigma_velocity_n.tobytes()))
        return in_flight(source, config, method, shown, time_ns, later_ns, near)

    class Seeking(filter_run):
        def __init__(self, start, settings, **how):
            super().__init__(start, settings, **how)
            sought.append((start.nav.tobytes(), settings))

    monkeypatch.setattr(initial_state, "in_flight", aligning)
    monkeypatch.setattr(white_noise, "InsGnssFilter", Seeking)
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss={"lever_arm": tuple(LEVER)})
    assert start.grade.by_drift
    assert len(aligned) == len(set(aligned)) > 0
    assert len(sought) == len(set(sought)) > 2


def standing(path):
    return simulated(
        path, "drive", "--duration", "60", "--still", "60", "--grade", "mems", "--rate", "50",
        "--seed", "3",
    )  # fmt: skip


def straight_on(path):
    """Gyros whose bias nothing shows: others are tried where an answer is not good."""
    return write(path, record(cruise(80.0), CONSUMER, 5, sigma=0.9, sigma_v=0.2))


def too_short(path):
    """Fixes for less time than alignment in motion needs."""
    return write(path, record(cruise(8.0), GRADES["industrial"], 5, sigma=0.9, sigma_v=0.2))


@pytest.mark.slow
@pytest.mark.parametrize("made", [standing, straight_on])
def test_a_start_that_is_not_there_is_looked_for_once(tmp_path, monkeypatch, made):
    """By what is refused an answer differs in its last word alone, and at another latency, where
    it fits and is not known well enough, in nothing that helps."""
    log = made(tmp_path / "log.mcap")
    tried = []
    align_in_flight = in_motion.align_in_flight

    def aligning(imu, fixes, settings):
        refused = replace(settings, refuse_sigma=1.0)
        tried.append((refused, imu.time_ns[-1], imu.delta_theta.tobytes()))
        return align_in_flight(imu, fixes, settings)

    monkeypatch.setattr(in_motion, "align_in_flight", aligning)
    with pytest.raises(AlignmentError):
        start_of(log)
    assert len({settings.gnss_latency_s for settings, *_ in tried}) == 1
    assert len(tried) == len(set(tried))


@pytest.mark.parametrize("made", [standing, too_short])
def test_a_start_that_is_not_there_leaves_nothing_behind(tmp_path, made):
    """What was tried is free at once: a collection that comes late would find it in use."""
    log = made(tmp_path / "log.mcap")
    config = ProcessConfig(input={"gyro_unit": "rad/s"})
    with open_log(log) as opened:
        source = prepare(opened, config)
        make_plan(source, config)  # whatever is made but once
        gc.collect()
        gc.disable()
        try:
            make_plan(source, config)
            gc.set_debug(gc.DEBUG_SAVEALL)
            gc.collect()
            left = {type(each) for each in gc.garbage}
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            gc.enable()
    assert not left & {GnssEpochs, FrameType}
