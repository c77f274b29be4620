"""Barometers that fail in the middle of a log: what becomes of height, and what is said of it."""

import numpy as np
import pytest

from tests.pipelines.process.flights import finite, flight_log, run

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
@pytest.mark.parametrize("grade", ["perfect", "mems"])
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
    assert [e["kind"] for e in summary["height"]["events"]] == ["engaged", "frozen"]
    assert any("did not change for 30 s while the vehicle moved" in w for w in summary["warnings"])
    samples = summary["height"]["samples"]
    assert samples["frozen"] == pytest.approx(np.count_nonzero(f.seconds >= 120.0), abs=2)
    # it comes back from where the sensor hung, 60 m off, and then coasts
    climbed = np.ptp(f.height[(f.seconds > 90.0) & (f.seconds < 120.0)])
    assert climbed > 40.0
    if mode == "ins":
        at = np.searchsorted(f.flight.time_ns, f.baro_ns[0] + 125 * 10**9)
        assert abs(collected.column("vertical")[at, 0] - f.flight.height[at]) < 0.1 * climbed


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
