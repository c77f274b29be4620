"""Logs of the simulated launch, made once a session, and alignments of them."""

import functools
import tempfile
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from sinstool.cli.main import cli
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import Losses, read_columns
from sinstool.pipelines.align.log import align_log

PERFECT = ("--grade", "perfect", "--gnss-model", "perfect")
TACTICAL = ("--launch-grade", "1")
TRUTH = "/truth/imu"
_FOLDER = tempfile.TemporaryDirectory(prefix="launches")


@functools.cache
def launched(*options, duration=90):
    """A log with increments, unless the options say otherwise."""
    out = Path(_FOLDER.name) / f"{abs(hash((options, duration)))}.mcap"
    arguments = ["simulate", "launch", "-o", str(out), "--duration", str(duration), *options]
    result = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert result.exception is None, result.output
    return out


def aligned(log, truth=TRUTH, method="svd", **groups):
    """What `align` finds; the log holds increments, unless the groups say otherwise."""
    groups["input"] = {"gyro_kind": "increment", **groups.get("input", {})}
    groups["align"] = {"align": method, **groups.get("align", {})}
    return align_log(log, build(ProcessConfig, groups), truth=truth)


def total(result):
    return result.result.truth.total_deg


def normalised(result):
    """Squared error by its covariance, over 3."""
    psi = np.array(result.result.truth.error_deg)
    return float(psi @ np.linalg.solve(np.array(result.result.cov_deg2), psi)) / 3.0


def column(log, topic, paths):
    """Stamps in ns and numbers of a topic."""
    expected = {"sec": ["header.stamp.sec"], "ns": ["header.stamp.nanosec"], "x": paths}
    with open_log(log) as opened:
        blocks = [v for _, v in read_columns(opened, opened.channels_of(topic), expected, Losses())]
    sec, ns, x = (np.concatenate([b[k] for b in blocks]) for k in expected)
    return sec.astype(np.int64) * 10**9 + ns.astype(np.int64), x
