"""The INS/GNSS filter over whole logs: errors within sigmas, outages, wrong settings, blocks."""

import numpy as np
import pytest

from sinstool.core.errors import AlignmentError
from sinstool.methods.ins_gnss.withheld import Withheld
from sinstool.pipelines.process.ins_gnss import run as filter_run
from sinstool.survey import source
from tests.helpers.filter_logs import CAUSES, errors, nees, rms, run, simulated

PLACE = ("--latitude", "-43.5", "--longitude", "179.996")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Eastward over the date line, south of the equator, with a second of everything odd."""
    path = tmp_path_factory.mktemp("filter") / "drive.mcap"
    return simulated(
        path, "drive", "--grade", "tactical", "--seed", "3", "--duration", "260", "--heading", "90",
        "--gnss-latency", "0.12", "--lever-arm", "0.8,-0.4,-1.2", "--gnss-flat", "150:170",
        "--still", "30", "--baro-sigma", "2", *PLACE,
    )  # fmt: skip


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    path = tmp_path_factory.mktemp("filter") / "flight.mcap"
    return simulated(
        path, "manoeuvring-flight", "--grade", "tactical", "--seed", "11", "--duration", "240",
        "--latitude", "52", "--longitude", "13",
    )  # fmt: skip


ARM = {"lever_arm": (0.8, -0.4, -1.2)}


@pytest.mark.slow
def test_drive_is_known_as_well_as_it_says(drive):
    chosen, solution = run(drive, gnss=ARM)
    assert solution.time_ns[0] == int(chosen["imu"]["first_ns"])
    assert len(solution) == chosen["imu"]["n"] == 26001
    result = chosen["filter"]
    assert result["gnss_latency_s"] == pytest.approx(0.12, abs=0.012)
    assert result["restarts"] == 0
    assert result["epochs_gated"] <= 0.01 * result["epochs_used"]
    assert CAUSES.isdisjoint(finding["kind"] for finding in chosen["findings"])
    assert 0.7 < result["mean_nis"] < 1.2
    assert solution.position[:, 1].min() < -3.1 and solution.position[:, 1].max() > 3.1
    off = errors(drive, solution)
    mean, most = nees(*off["attitude"])
    # misaligned axes, too, are one draw: over 50 drives the mean is 1.0
    assert 0.1 < mean < 3.0 and most < 4.5
    mean, most = nees(*off["position"])
    assert mean < 4.0 and most < 4.5  # one error of GNSS that lasts is one draw, not many


@pytest.mark.slow
def test_smoothing_is_better_and_serves_the_beginning_too(drive):
    off, smooth_off = {}, {}
    for smooth, into in ((False, off), (True, smooth_off)):
        _, solution = run(drive, gnss=ARM, filter={"smooth": smooth})
        into |= errors(drive, solution)
    assert rms(smooth_off["attitude"][0]) < 0.8 * rms(off["attitude"][0])
    first = slice(0, 100)  # the rest, which the filter knows by its start alone
    assert rms(smooth_off["attitude"][0][first]) < 0.9 * rms(off["attitude"][0][first])
    assert nees(*smooth_off["attitude"])[1] < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["network-26", "baro-24", "plain-15"])
def test_every_filter_runs(flight, kind):
    chosen, solution = run(flight, filter={"filter": kind})
    assert chosen["filter"]["filter"] == kind
    off = errors(flight, solution)
    assert rms(off["attitude"][0]) < np.radians(0.5)
    mean, _ = nees(*off["position"])
    assert mean < 3.0
    # Its innovations are small, as it follows slow errors of fixes
    assert any("follows those that vary slowly" in w for w in chosen["warnings"]) == (
        kind == "plain-15"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"filter": {"feedback": "none"}},
        {"filter": {"adaptive": "sage-husa", "schmidt_epsilon": 0.05}},
        {"vertical": {"height_damping": "baro", "k4": 0.5, "tau": 5.0}},
    ],
    ids=["open loop", "adaptive", "K4"],
)
def test_variants_are_no_worse(flight, options):
    chosen, solution = run(flight, **options)
    off = errors(flight, solution)
    assert chosen["filter"]["epochs_gated"] <= 3
    assert rms(off["attitude"][0]) < np.radians(0.5)
    assert nees(*off["position"])[0] < 3.0


@pytest.mark.slow
def test_outages_are_bridged_and_scored(flight):
    hidden = ("100:130", "170:200")
    chosen, solution = run(flight, filter={"withhold_gnss": hidden, "smooth": True})
    scores = chosen["filter"]["withheld"]
    assert [o["epochs"] for o in scores["outages"]] == [30, 30]
    assert max(o["largest_in_sigmas"] for o in scores["outages"]) < 4.0
    for o in scores["filter"]["outages"]:
        assert o["largest_in_sigmas"] < 4.0
    # Fixes hold their own slow error; the truth shows what smoothing is worth.
    off = errors(flight, solution)["position"]
    assert nees(*off)[1] < 4.0
    _, filtered = run(flight, filter={"withhold_gnss": hidden})
    t = (filtered.time_ns - filtered.time_ns[0])[::20] * 1e-9
    end = (np.abs(t - 128.0) < 2.0) | (np.abs(t - 198.0) < 2.0)
    velocity = filtered.covariance_velocity_n[::20][end].trace(axis1=1, axis2=2).mean()
    smooth = solution.covariance_velocity_n[::20][end].trace(axis1=1, axis2=2).mean()
    assert smooth < 0.5 * velocity


@pytest.mark.slow
@pytest.mark.parametrize("feedback", ["closed", "none"])
def test_linear_innovations_score_a_filter_with_feedback_only(flight, monkeypatch, feedback):
    """Without it they are right where the outputs are far off."""
    scored = []
    monkeypatch.setattr(Withheld, "filtered", lambda _, gnss: scored.append(gnss))
    options = {"withhold_gnss": ("100:130",), "feedback": feedback}
    chosen, _ = run(flight, filter=options)
    assert len(chosen["filter"]["withheld"]["outages"]) == 1
    assert bool(scored) == (feedback == "closed")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"gnss": {"gnss_latency": 0.1}}, "latency", "not 100 ms"),
        ({"gnss": {"lever_arm": (1.2, 0.0, 0.0)}}, "lever-arm", "antenna were -1.2"),
        ({"filter": {"gnss_noise_scale": 0.33}}, "gnss-noise", "too small"),
        ({"filter": {"gnss_noise_scale": 3.0}}, "gnss-noise", "too large"),
    ],
)
def test_wrong_settings_are_named(flight, options, kind, words):
    chosen, _ = run(flight, **options)
    result = [f for f in chosen["findings"] if f["kind"] in CAUSES]
    assert any(f["kind"] == kind and words in f["text"] + f["answer"] for f in result), result
    assert any(w.startswith(result[0]["text"]) for w in chosen["warnings"])


@pytest.mark.slow
def test_a_grade_that_noise_at_rest_contradicts_is_reported(drive):
    chosen, _ = run(drive, gnss=ARM, navigation={"imu_grade": "navigation"})
    assert any("noise at rest" in w for w in chosen["warnings"])


@pytest.mark.slow
def test_blocks_change_no_bit(flight, monkeypatch):
    _, whole = run(flight)
    monkeypatch.setattr(filter_run, "DETAIL_ROWS", 1009)
    original = source.imu_blocks.__defaults__
    monkeypatch.setattr(source.imu_blocks, "__defaults__", (original[0], 777))
    _, pieces = run(flight)
    for name, values in vars(whole).items():
        assert np.array_equal(values, getattr(pieces, name)), name


@pytest.mark.slow
def test_without_velocity_a_start_is_found_from_positions(tmp_path):
    log = simulated(
        tmp_path / "positions.mcap", "drive", "--grade", "mems", "--seed", "6", "--duration", "200",
        "--still", "20", "--no-velocity", "--baro-rate", "0",
    )  # fmt: skip
    chosen, solution = run(log)
    assert chosen["filter"]["filter"] == "markov-27"
    off = errors(log, solution)
    assert nees(*off["attitude"])[1] < 4.0
    assert rms(off["attitude"][0]) < np.radians(8.0)


@pytest.mark.slow
def test_part_of_a_log_and_given_attitudes(drive):
    chosen, solution = run(
        drive, gnss=ARM, input={"start": "40", "end": "160"}, filter={"smooth": True}
    )
    assert len(solution) == 12001
    assert nees(*errors(drive, solution)["attitude"])[1] < 4.5
    align = {"align": "fixed", "initial_attitude": (0.0, 0.0, 90.0)}
    chosen, solution = run(drive, gnss=ARM, align=align)
    assert chosen["filter"]["start"]["how"] == "attitude by fixed"
    assert rms(errors(drive, solution, 120.0)["attitude"][0]) < np.radians(0.5)
    with pytest.raises(AlignmentError, match="gives no heading"):
        run(drive, gnss=ARM, align={"align": "level"})
