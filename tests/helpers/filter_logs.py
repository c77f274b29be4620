"""Runs of the INS/GNSS filter over simulated logs, and how far they are from the truth."""

from pathlib import Path

import numpy as np
from click.testing import CliRunner

from sinstool.cli.main import cli
from sinstool.config import ProcessConfig
from sinstool.core.streams import concatenate
from sinstool.io.readers import open_log
from sinstool.pipelines.planning import make_plan
from sinstool.pipelines.process.errors_against_truth import Errors, read_references
from sinstool.pipelines.process.ins_gnss.start import timed_start
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.pipelines.process.run import process
from sinstool.survey.source import prepare

# What the diagnosis of a filter can name.
CAUSES = {
    "axes", "initial-attitude", "latency", "velocity-lag", "lever-arm", "gnss-noise", "imu-noise",
    "divergence",
}  # fmt: skip


class Capture:
    """Takes a run's solutions instead of drawing them."""

    def __init__(self):
        self.parts = []

    def push(self, solution):
        self.parts.append(solution)

    def refer_height(self, *_):
        pass

    refer_track = refer_filter = free_heading = refer_height

    @property
    def solution(self):
        return concatenate(self.parts)


def simulated(path, scenario, *options):
    """A log by `sinstool simulate`."""
    ran = CliRunner().invoke(cli, ["simulate", scenario, "-o", str(path), *options])
    assert ran.exit_code == 0, ran.output
    return path


def run(log, **groups):
    """Summary and solutions of a run."""
    groups.setdefault("navigation", {})["mode"] = "ins-gnss"
    groups.setdefault("input", {}).setdefault("gyro_unit", "rad/s")
    groups.setdefault("output", {}).update(only_results=True, overwrite=True)
    capture = Capture()
    out = Path(log).with_suffix(".out.mcap")
    result = process(Path(log), out, ProcessConfig(**groups), None, capture)
    out.unlink()
    solution = capture.solution
    for name, values in vars(solution).items():
        assert values is None or np.isfinite(values).all(), name
    return result.to_json(), solution


def start_of(log, **groups):
    """What a run would start from, its latency as the log shows it."""
    groups.setdefault("navigation", {})["mode"] = "ins-gnss"
    config = ProcessConfig(**groups)
    with open_log(Path(log)) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        return timed_start(source, config, plan.algorithm, plan.filter_start)


def first_start_of(log, **groups):
    """What a run would start from before it asks the log for a latency; its increments, too."""
    config = ProcessConfig(**groups)
    with open_log(Path(log)) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        first = plan.filter_start
        return first, motion_from(source, config, plan.algorithm, first.time_ns)


def errors(log, solution, begin_s=0.0):
    """Errors by kind, less those of the first seconds, with their covariances."""
    with open_log(Path(log)) as opened:
        truth = read_references(opened, ("/truth/imu", "/truth/fix"), "flu")
    late = solution.time_ns >= solution.time_ns[0] + round(begin_s * 1e9)
    rows = solution.rows(np.flatnonzero(late)[::20])
    held = Errors(truth)
    return {
        "attitude": (held.push("attitude", rows), rows.covariance_attitude_n),
        "position": (held.push("position", rows), rows.covariance_position_n),
    }


def nees(error, covariance):
    """Normalised estimation error squared over its dimension, in the mean; largest in sigmas."""
    known = np.isfinite(error).all(axis=1)
    error, covariance = error[known], covariance[known]
    weighted = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    mean = float(np.mean(np.sum(weighted * error, axis=1)) / 3.0)
    return mean, float(np.max(np.abs(error) / sigma))


def rms(error):
    """Root mean square size of three components."""
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=1))))
