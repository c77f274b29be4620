"""Options of `process`, one for a log, that need not suit it: for the programs that hunt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmarks.common import FloatArray
from sinstool.core.rotation import from_dcm, to_euler
from sinstool.core.units import DEGREE
from sinstool.methods.sensor_errors import IMU_GRADES

# Each kind is as likely as any other, and so is each of its words
Kinds = Mapping[str, Sequence[str]]

SENSORS: Kinds = {
    "--imu-grade": tuple(IMU_GRADES),
    "--arw": ("0.001", "10"),
    "--sigma-bg": ("0.01", "5000"),
    "--sigma-ba": ("0.0001", "1"),
    "--gyro-kind": ("rate", "mean-rate"),
    "--body-axes": ("frd",),
    "--imu-stamps": ("even", "kept"),
    "--gnss-stamps": ("even", "kept"),
}
WITH_GNSS: Kinds = {
    **SENSORS,
    "--vrw": ("1", "10000"),
    "--sigma-sf": ("0.000001", "0.05"),
    "--bias-time": ("5", "1000000"),
    "--gnss-noise-scale": ("0.1", "0.3", "10"),
    "--gnss-sigma": ("0.02", "50"),
    "--gnss-sigma-v": ("0.01", "1"),
    "--gnss-velocity-lag": ("0.2", "-0.2"),
    "--gnss-clock-offset": ("0.5", "-2"),
    "--vehicle": ("land",),
    "--feedback": ("none",),
    "--virtual-noise": ("on", "off"),
    "--adaptive": ("sage-husa", "innovation"),
    "--restart-after": ("3", "300"),
    "--refine": ("none",),
    "--kappa": ("0.05",),
    "--height-damping": ("gnss",),
    "--align": ("gyrocompass", "level"),
    "--start": ("20", "60", "100"),
}
WITHOUT_GNSS: Kinds = {
    **SENSORS,
    "--motion": ("hand", "vehicle"),
    "--align": ("level",),
    "--imu-rate": ("200",),
    "--max-gap": ("5",),
}
VECTORS = ("win", "cen", "int", "diff", "diffc", "pos")
FAR_DEG = (0.0, 5.0, 15.0, 20.0, 90.0, 180.0)


def with_gnss(random: np.random.Generator, c_nb: FloatArray) -> list[str]:
    """One option, at random, for a log with GNSS.

    Parameters
    ----------
    c_nb : ndarray, shape (3, 3)
        First attitude: one that is stated is off by nothing to half a turn, in roll or in heading.
    """

    def fixed() -> list[str]:
        stated = to_euler(from_dcm(c_nb)) / DEGREE
        stated[random.choice([0, 2])] += random.choice(FAR_DEG)
        return ["--align", "fixed", "--initial-attitude", ",".join(f"{x:.2f}" for x in stated)]

    def mount() -> list[str]:
        angles = ",".join(f"{x:.0f}" for x in random.uniform(-30.0, 30.0, 3))
        return ["--mount", angles, "--vehicle", str(random.choice(["auto", "land"]))]

    def vectors() -> list[str]:
        solver = str(random.choice(["triad", "quest", "davenport"]))
        return ["--align", solver, "--vectors", str(random.choice(VECTORS))]

    return _one(random, WITH_GNSS, [fixed, mount, vectors, lambda: _bias(random, 0.01)])


def without_gnss(random: np.random.Generator) -> list[str]:
    """One option, at random, for a log without GNSS."""
    return _one(random, WITHOUT_GNSS, [lambda: _bias(random, 0.02)])


def _one(
    random: np.random.Generator, kinds: Kinds, more: Sequence[Callable[[], list[str]]]
) -> list[str]:
    names = list(kinds)
    at = int(random.integers(len(names) + len(more)))
    if at >= len(names):
        return more[at - len(names)]()
    return [names[at], str(random.choice(kinds[names[at]]))]


def _bias(random: np.random.Generator, large: float) -> list[str]:
    """A bias of the gyros, small or large, rad/s."""
    bias = random.standard_normal(3) * random.choice([0.001, large])
    return ["--gyro-bias", ",".join(f"{x:.4f}" for x in bias)]
