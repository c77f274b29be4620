"""Fixes that a converter interpolated are left out; measurements, however smooth, are not."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.config import InputOptions
from sinstool.core.earth import displaced
from sinstool.core.streams import Gnss
from sinstool.io.readers import open_log
from sinstool.survey.gnss import read_gnss
from sinstool.survey.interpolated import interpolated, on_lines
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import PERFECT, drive, record, write

SECONDS = np.arange(0.0, 120.0, 0.1)


def fixes(seconds, north, east, decimals=None):
    """At some times, s, and places, m; degrees rounded to so many decimals."""
    n = len(seconds)
    latitude, longitude = displaced(0.8, 0.2, 100.0, north, east)
    if decimals is not None:
        latitude, longitude = (
            np.deg2rad(np.round(np.rad2deg(x), decimals)) for x in (latitude, longitude)
        )
    times = T0 + np.round(seconds * 1e9).astype(np.int64)
    return Gnss(times, times, latitude, longitude, np.full(n, 100.0), np.zeros((n, 3, 3)),
                np.zeros(n), np.zeros(n, int))  # fmt: skip


def curve(seconds, noise, seed, speed=5.0):
    """A winding way at some speed, m/s, with noise, m."""
    random = np.random.default_rng(seed)
    course = 2.0 * np.sin(0.13 * seconds) + np.cos(0.31 * seconds)
    step = np.gradient(seconds) * speed
    north, east = np.cumsum(step * np.cos(course)), np.cumsum(step * np.sin(course))
    return (x + noise * random.standard_normal(len(x)) for x in (north, east))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("interval", [0.4, 0.53, 1.0])
@pytest.mark.parametrize("speed", [0.4, 20.0])
def test_what_is_interpolated_between_fixes_is_left_out(interval, speed, seed):
    """Nine at 10 Hz to a second, whether or not the fixes themselves are among them."""
    at = np.arange(0.0, 121.0, interval)
    north, east = curve(at, 0.01, seed, speed)
    made = fixes(SECONDS, np.interp(SECONDS, at, north), np.interp(SECONDS, at, east))
    between, times = interpolated(made)
    assert times == pytest.approx(interval / 0.1, abs=1.0)
    assert np.count_nonzero(~between) == pytest.approx(120.0 / interval, rel=0.1)
    # Those that stay are within a step of a fix
    off = SECONDS[~between][1:-1] / interval
    assert np.abs(off - np.round(off)).max() * interval < 0.1 + 1e-9


@pytest.mark.parametrize("noise", [0.0, 0.005, 2.0])
@pytest.mark.parametrize("decimals", [None, 7])
@pytest.mark.parametrize("speed", [0.0, 0.3, 30.0])
def test_measurements_are_not_interpolated(noise, decimals, speed):
    north, east = curve(SECONDS, noise, 1, speed)
    assert not interpolated(fixes(SECONDS, north, east, decimals))[0].any()
    # Nor those of a simulator on a straight way, with a turn now and then
    east = np.interp(SECONDS, [0.0, 33.0, 71.0, 120.0], [0.0, 300.0, 300.0, 0.0])
    assert not interpolated(fixes(SECONDS, 5.0 * SECONDS, east, decimals))[0].any()


def test_velocities_are_left_out_with_their_fixes(tmp_path):
    truth = drive(41, 120.0, rest=5.0)
    data = record(truth, PERFECT, 41, gnss_rate=1.0, sigma=0.5, sigma_v=0.05)
    once = data.fixes
    at = np.arange(once.seconds[0], once.seconds[-1], 0.1)

    def between(column):
        columns = np.asarray(column, float).reshape(len(once.seconds), -1).T
        rows = np.stack([np.interp(at, once.seconds, one) for one in columns], axis=1)
        return rows.reshape(len(at), *np.shape(column)[1:])

    changed = {
        name: between(value)
        for name, value in vars(once).items()
        if np.ndim(value) and name != "seconds"
    }
    data = replace(data, fixes=replace(once, seconds=at, **changed))
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        aiding = read_gnss(log, InputOptions(), False)
    assert len(aiding.gnss) == pytest.approx(len(once.seconds), abs=3)
    (finding,) = (f for f in aiding.findings if f.kind == "interpolated-fixes")
    assert "every 10th" in finding.text


def test_too_few_rows():
    assert not on_lines(np.arange(2), np.zeros((2, 2))).any()
