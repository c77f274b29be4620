"""Barometers that fail in the middle of a log: what becomes of height, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.simulation.sensors import with_errors
from tests.helpers.quick import mostly_slow
from tests.pipelines.process.flights import NOISE_AND_BIASES, finite, flight_log, run

EVERY = slice(500, 12000, 97)


def gap(f):
    keep = (f.seconds < 100.0) | (f.seconds > 150.0)
    f.baro_ns, f.pressure, f.height = f.baro_ns[keep], f.pressure[keep], f.height[keep]


def jump(f):
    f.spoil(40.0, f.seconds >= 120.0)


def spikes(f):
    random = np.random.default_rng(5)
    where = random.choice(np.arange(100, len(f.pressure)), 60, replace=False)
    f.spoil(random.uniform(30.0, 300.0, 60) * random.choice([-1, 1], 60), where)


def impossible(f):
    f.pressure[1000:1010] = np.nan
    f.pressure[2000:2005] = 0.0
    f.pressure[3000:3003] = -5.0
    f.pressure[4000] = np.inf


def stamps(f):
    k = np.arange(500, 11000, 50)
    f.baro_ns[k], f.baro_ns[k + 1] = f.baro_ns[k + 1].copy(), f.baro_ns[k].copy()
    f.baro_ns[k + 10] = f.baro_ns[k + 9]


# What is done to the barometer, by grade: largest errors of height (m) and of vertical velocity
# (m/s), and what the summary counts and says.
CASES = {
    "gap": (gap, (0.2, 4.0), (0.05, 0.3), {}, "good again at 150"),
    "jump": (jump, (0.5, 0.5), (0.05, 0.2), {"gate": 38}, "jumped by +39.9 m at 120.8 s"),
    "spikes": (spikes, (0.2, 0.3), (0.02, 0.15), {"gate": 60}, "60 too far off"),
    "impossible": (
        impossible,
        (0.2, 0.3),
        (0.02, 0.15),
        {"not_finite": 11, "out_of_range": 8},
        "11 not finite, 8 outside the range of air pressure",
    ),
    "stamps": (stamps, (0.2, 0.3), (0.02, 0.15), {"stamp": 210}, "stamp repeats or goes back"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("grade", mostly_slow(["perfect", "mems"], "mems"))
@pytest.mark.parametrize("case", CASES)
def test_height_stays(tmp_path, case, grade):
    change, most, fastest, counts, words = CASES[case]
    f = flight_log()
    change(f)
    log = f.write(tmp_path / "log.mcap", grade=grade)
    options = f.options(vertical={"height_damping": "baro"})
    summary, collected = run(log, tmp_path / "out.mcap", options)
    assert finite(collected.parts)
    vertical = collected.column("vertical")
    k = grade == "mems"
    assert np.abs(vertical[:, 0] - f.flight.height).max() < most[k]
    assert np.abs(vertical[:, 1] + f.flight.velocity_n[:, 2]).max() < fastest[k]
    samples = summary["height"]["samples"]
    for name, count in counts.items():
        assert samples[name] == count
    assert sum(samples.values()) == len(f.pressure)
    assert any(words in text for text in summary["warnings"])
    assert not any("from that of GNSS" in text for text in summary["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["ins", "attitude"])
@pytest.mark.parametrize("by_setting", [False, True])
def test_a_height_that_is_not_that_of_gnss_is_said(tmp_path, mode, by_setting):
    """A sensor that hangs from its first sample on was followed, tens of metres off, silently."""
    f = flight_log()
    vertical = {"height_damping": "baro", **({"qnh": 101325.0} if by_setting else {})}
    options = f.options(navigation={"mode": mode}, vertical=vertical)
    sound, _ = run(f.write(tmp_path / "sound.mcap"), tmp_path / "a.mcap", options)
    assert not any("from that of GNSS" in text for text in sound["warnings"])
    f.pressure[:] = f.pressure[0]
    summary, collected = run(f.write(tmp_path / "log.mcap"), tmp_path / "b.mcap", options)
    off = collected.column("vertical")[:, 0] - f.flight.height
    assert np.ptp(off) > 30.0
    (text,) = [text for text in summary["warnings"] if "from that of GNSS" in text]
    said = float(text.split("up to ")[1].split(" m")[0])
    if not by_setting:  # else the level is not compared
        assert 0.7 * np.abs(off).max() < abs(said) < 1.1 * np.abs(off).max()
    assert abs(said) > 15.0


@pytest.mark.parametrize("mode", ["ins", "attitude"])
def test_a_sensor_that_hangs_is_left_behind(tmp_path, mode):
    f = flight_log()
    late = f.seconds >= 90.0
    f.pressure[late] = f.pressure[late][0]
    log = f.write(tmp_path / "log.mcap")
    options = f.options(navigation={"mode": mode}, vertical={"height_damping": "baro", "tau": 5.0})
    summary, collected = run(log, tmp_path / "out.mcap", options)
    assert finite(collected.parts)
    assert [e["kind"] for e in summary["height"]["events"]] == ["engaged", "coast"]
    assert any("hangs, repeating one value, from 90.0 to" in w for w in summary["warnings"])
    assert summary["height"]["samples"]["frozen"] == np.count_nonzero(late) - 1
    if mode == "ins":
        at = np.searchsorted(f.flight.time_ns, f.baro_ns[0] + 125 * 10**9)
        assert abs(collected.column("vertical")[at, 0] - f.flight.height[at]) < 3.0


@pytest.mark.parametrize("mode", ["ins", "attitude"])
def test_a_coast_that_ends_far_off_is_not_to_be_trusted(tmp_path, mode):
    """Of a sensor that hung for 40 s, beside an accelerometer whose bias changed: status was 0."""
    f = flight_log()
    hung = (f.seconds >= 90.0) & (f.seconds <= 130.0)
    f.pressure[hung] = f.pressure[hung][0]
    imu = with_errors(f.flight.imu, NOISE_AND_BIASES["mems"], 0)
    late = (imu.time_ns - imu.time_ns[0] > 95 * 10**9)[:, None]
    force = imu.mean_specific_force - late * np.array([0.0, 0.0, 0.3])
    log = f.write(tmp_path / "log.mcap", imu=replace(imu, mean_specific_force=force))
    options = f.options(navigation={"mode": mode}, vertical={"height_damping": "baro"})
    summary, collected = run(log, tmp_path / "out.mcap", options)
    off = np.abs(collected.column("vertical")[:, 0] - f.flight.height)
    seconds = (collected.column("time_ns") - f.baro_ns[0]) * 1e-9
    assert off[(seconds > 90.0) & (seconds < 131.0)].max() > 100.0
    assert off[seconds < 90.0].max() < 5.0
    (lost,) = [one for one in summary["findings"] if "not to be trusted" in one["text"]]
    assert lost["kind"] == "height" and lost["severity"] == "lost"
    assert lost["text"].startswith("height from 90.0 s to 130.0 s")


def test_a_jump_is_no_scale(tmp_path):
    """Neither is a gap, across which the pressure would be interpolated."""
    f = flight_log()
    jump(f)
    gap(f)
    options = f.options(vertical={"height_damping": "baro"})
    summary, _ = run(f.write(tmp_path / "log.mcap"), tmp_path / "out.mcap", options)
    assert summary["height"]["reference"]["scale"] == pytest.approx(1.0, abs=1e-3)
    assert summary["height"]["offset_m"] == pytest.approx(-40.0, abs=0.5) or (
        summary["height"]["offset_m"] == 0.0
    )


def test_a_warm_day_is_a_scale(tmp_path):
    f = flight_log()
    rise = f.height - f.height[0]
    f.spoil(-0.05 * rise, slice(None))
    options = f.options(vertical={"height_damping": "baro"})
    summary, collected = run(f.write(tmp_path / "log.mcap"), tmp_path / "out.mcap", options)
    assert summary["height"]["reference"]["scale"] == pytest.approx(1.0 / 0.95, abs=2e-3)
    assert np.abs(collected.column("vertical")[:, 0] - f.flight.height).max() < 0.5
    assert any("scale is 1.05" in w for w in summary["warnings"])


@pytest.mark.parametrize("mode", ["ins", "attitude"])
def test_a_sensor_that_hangs_for_seconds_is_no_jump(tmp_path, mode):
    """What it missed was taken off as a jump of the sensor: height stayed 17 m off."""
    f = flight_log()
    hangs = (f.seconds >= 95.0) & (f.seconds < 103.0)
    f.pressure[hangs] = f.pressure[hangs][0]
    assert np.ptp(f.height[hangs]) > 15.0
    log = f.write(tmp_path / "log.mcap", grade="mems")
    options = f.options(navigation={"mode": mode}, vertical={"height_damping": "baro"})
    summary, collected = run(log, tmp_path / "out.mcap", options)
    off = collected.column("vertical")[:, 0] - np.interp(
        collected.column("time_ns"), f.flight.time_ns, f.flight.height
    )
    assert np.abs(off).max() < 3.0
    kinds = [e["kind"] for e in summary["height"]["events"]]
    assert kinds == ["engaged", "coast", "re-engaged"]
    (said,) = [w for w in summary["warnings"] if "hangs, repeating one value" in w]
    assert "from 95.0 to 103.0 s" in said


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_sigma_of_a_height_that_returns_to_the_barometer_includes_what_fades(
    tmp_path, seed, smooth
):
    """After a minute without fixes and barometer, the output leaves the coast slowly.

    A smoother knows both sides, and makes no step that had to fade.
    """
    f = flight_log(seed=seed)
    keep = (f.seconds < 100.0) | (f.seconds > 160.0)
    f.baro_ns, f.pressure = f.baro_ns[keep], f.pressure[keep]
    imu = with_errors(f.flight.imu, NOISE_AND_BIASES["mems"], seed)
    imu.mean_specific_force[(imu.time_ns - imu.time_ns[0]) * 1e-9 > 100.0, 2] += 0.005
    log = f.write(tmp_path / "log.mcap", imu=imu)
    options = f.options(
        navigation={"mode": "ins-gnss"},
        filter={"withhold_gnss": ("95:161",), "gnss_noise_scale": 0.1, "smooth": smooth},
    )
    _, collected = run(log, tmp_path / "out.mcap", options)
    seconds = (collected.column("time_ns") - f.flight.time_ns[0]) * 1e-9
    off = collected.column("position")[:, 2] - np.interp(
        collected.column("time_ns"), f.flight.time_ns, f.flight.height
    )
    sigma = np.sqrt(collected.column("covariance_position_n")[:, 2, 2])
    after = (seconds > 163.0) & (seconds < 195.0)
    assert smooth or np.abs(off[after]).max() > 3.0
    assert np.abs(off / sigma)[after].max() < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["attitude", "ins", "ins-gnss"])
def test_a_barometer_that_lags_is_named(tmp_path, mode):
    """Stamped on receipt, seconds late: heights were 10 m off in climbs, and nothing was said."""
    f = flight_log()
    vertical = {"height_damping": "baro"}
    options = f.options(navigation={"mode": mode}, vertical=vertical)
    sound, _ = run(f.write(tmp_path / "sound.mcap", grade="mems"), tmp_path / "a.mcap", options)
    assert not any("barometer lags" in text for text in sound["warnings"])
    f.baro_ns += 2 * 10**9
    late = f.write(tmp_path / "late.mcap", grade="mems")
    summary, _ = run(late, tmp_path / "b.mcap", options)
    (text,) = [text for text in summary["warnings"] if "barometer lags" in text]
    said = text.split("--baro-lag ")[1].split(",")[0]
    assert f"{said} s behind" in text
    assert float(said) == pytest.approx(2.0, abs=0.11)
    options = f.options(navigation={"mode": mode}, vertical={**vertical, "baro_lag": 2.0})
    told, _ = run(late, tmp_path / "c.mcap", options)
    assert not any("barometer lags" in text for text in told["warnings"])


def test_height_begins_where_the_barometer_is(tmp_path):
    """Without fixes it began at 0 m, 1200 m off, until two samples agreed."""
    f = flight_log()
    f.baro_ns, f.pressure = f.baro_ns[::50], f.pressure[::50]  # one a second
    vertical = {"height_damping": "baro", "qnh": 101325.0}
    options = f.options(navigation={"mode": "attitude"}, vertical=vertical)
    log = f.write(tmp_path / "log.mcap", gnss=False)
    _, collected = run(log, tmp_path / "out.mcap", options)
    off = collected.column("vertical")[:, 0] - f.flight.height
    assert np.abs(off).max() < 20.0
