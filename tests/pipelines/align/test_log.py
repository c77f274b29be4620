"""Alignment of logs in motion: exact data exactly, and what logs of the world do."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core import rotation
from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment.inflight_answer import InFlightAlignment
from sinstool.pipelines.align.log import align_log, errors, tilt_errors
from tests.helpers.filter_logs import simulated
from tests.helpers.launch_logs import (
    PERFECT,
    TACTICAL,
    aligned,
    column,
    launched,
    normalised,
    total,
)

# Where the dynamics are, 40 m/s^2 and a roll of 220 deg/s among them.
BOOST = {"gate": "off", "align_start": 0.0, "align_end": 25.0, "refine": "none"}


# -- exact data ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("vectors", ["win", "int", "cen", "diffc", "pos"])
def test_exact_data_gives_the_exact_attitude(vectors):
    result = aligned(launched(*PERFECT), in_flight={"vectors": vectors, "refine": "none"})
    assert result.result.status in ("ok", "degraded")
    assert total(result) < 0.002


@pytest.mark.parametrize("method", ["quest", "davenport", "triad"])
def test_so_does_every_solver(method):
    result = aligned(launched(*PERFECT), method=method, in_flight={"refine": "none"})
    assert result.result.method == method
    assert total(result) < 0.002


@pytest.mark.parametrize(("method", "vectors"), [("svd", "win"), ("svd", "int"), ("triad", "win")])
def test_in_the_boost_too(method, vectors):
    result = aligned(launched(*PERFECT), method=method, in_flight={**BOOST, "vectors": vectors})
    assert result.result.gate == "off"
    assert total(result) < 0.005


# Noise alone does not show that gyros are tactical
SAID = {"navigation": {"imu_grade": "tactical"}}


def test_a_backward_difference_lags():
    # Half a fix interval of what force does meanwhile, which no noise is to blame for.
    lagging = total(aligned(launched(*PERFECT), in_flight={"vectors": "diff", "refine": "none"}))
    assert 0.01 < lagging < 0.5


@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
def test_whatever_a_sample_is(kind):
    log = launched(*PERFECT, "--gyro-kind", kind, duration=60)
    assert total(aligned(log, input={"gyro_kind": kind}, in_flight=BOOST)) < 0.005


@pytest.mark.parametrize(
    ("options", "groups"),
    [
        (("--latitude", "-35.3", "--longitude", "149.1"), {}),
        (("--latitude", "78", "--longitude", "179.95", "--heading", "80"), {}),
        (("--gnss-offset", "0.0337"), {}),
        (("--body-axes", "frd"), {"input": {"body_axes": "frd"}}),
        (("--lever-arm", "3,1.5,0.5"), {"gnss": {"lever_arm": (3.0, 1.5, 0.5)}}),
        (("--gnss-latency", "0.1"), {"gnss": {"gnss_latency": 0.1}}),
    ],
    ids=["south", "north and date line", "between samples", "frd", "lever-arm", "latency"],
)
def test_wherever_and_however(options, groups):
    result = aligned(launched(*PERFECT, *options), **groups)
    assert result.result.status == "ok"
    assert total(result) < 0.002
    assert result.result.chi2 < 1e-3


@pytest.mark.slow
def test_a_latency_and_lever_arm_that_were_not_given_show():
    late = aligned(launched(*PERFECT, "--gnss-latency", "0.1"), in_flight={"refine": "none"})
    assert total(late) > 0.1
    # the refinement finds it, with the attitude
    result = aligned(launched(*PERFECT, "--gnss-latency", "0.1"))
    assert total(result) < 0.01
    assert result.result.latency_s == pytest.approx(0.1, abs=0.002)
    # a long lever arm that nobody gave makes residuals that no noise explains
    apart = aligned(launched(*PERFECT, "--lever-arm", "3,1.5,0.5"), in_flight={"refine": "none"})
    assert apart.result.status == "degraded"
    assert any("antenna" in w for w in apart.result.warnings)


# -- sensors as they are ---------------------------------------------------------------------


def test_real_sensors_stay_within_their_sigmas():
    result = aligned(launched(*TACTICAL), **SAID)
    assert result.result.status == "ok"
    assert total(result) < 0.3
    assert 0.01 < normalised(result) < 4.0
    assert 0.9 < result.result.chi2 < 1.1
    assert 0.9 < result.result.refined_chi2 < 1.1
    bias = np.array(result.result.gyro_bias_deg_h)
    assert np.abs(bias).max() < 10.0


@pytest.mark.slow
def test_at_the_start_and_in_between():
    log = launched(*TACTICAL)
    ends = [aligned(log, in_flight={"at": at}) for at in ("start", "end", "60")]
    times = [f.result.time_s for f in ends]
    assert times[0] == pytest.approx(40.0, abs=0.2)
    assert times[1] == pytest.approx(90.0, abs=0.2)
    assert times[2] == pytest.approx(60.0, abs=1e-6)
    assert max(total(f) for f in ends) < 0.4


@pytest.mark.parametrize("rate", ["1", "4"])
def test_slow_receivers(rate):
    result = aligned(launched(*TACTICAL, "--gnss-rate", rate))
    assert result.result.status == "ok"
    assert normalised(result) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.02, 0.1])
def test_every_outlier_is_found(share):
    options = (*TACTICAL, "--gnss-outliers", str(share))
    clean, dirty = aligned(launched(*TACTICAL)), aligned(launched(*options))
    paths = [f"twist.twist.linear.{a}" for a in "xyz"]
    velocity = [column(launched(*o), "/gnss/velocity", paths) for o in (TACTICAL, options)]
    off = np.linalg.norm(velocity[1][1] - velocity[0][1], axis=1) > 1.0
    start = column(launched(*TACTICAL), "/imu/data_raw", ["angular_velocity.x"])[0][0]
    used = (velocity[1][0] - start) * 1e-9 >= dirty.result.start_s
    assert off[used].sum() > 5
    assert dirty.result.n_rejected == off[used].sum()
    assert clean.result.n_rejected == 0
    assert abs(total(dirty) - total(clean)) < 0.5 * clean.result.sigma_worst_deg


@pytest.mark.slow
def test_what_a_clipping_gyro_harms_is_left_out_without_the_gate_too():
    """Its fixes fit so badly that the minute does not show heading: it was 7 deg off, degraded."""
    log = launched(*TACTICAL, "--gyro-range", "200")
    gated = aligned(log, **SAID)
    assert total(gated) < 0.3
    without = aligned(log, in_flight={"gate": "off"}, **SAID)
    assert total(without) < 3.0 * without.result.sigma_worst_deg
    assert without.result.start_s >= 60.0
    assert any("aligned with what follows" in w for w in without.result.warnings)
    answer = aligned(log, in_flight={"gate": "off", "gyro_range": 200.0})
    assert answer.result.start_s == pytest.approx(11.1, abs=0.2)
    assert total(answer) < 0.2


@pytest.mark.slow
def test_a_launch_that_is_never_calm_enough_for_the_gate_is_aligned_without_it():
    """It ends before the gate opens, or rolls all the time; nothing saturates."""
    log = launched(*TACTICAL, duration=38)
    assert aligned(log, in_flight={"gate": "paper"}, **SAID).result.status == "failed"
    result = aligned(log, **SAID)
    assert result.result.status in ("ok", "degraded") and result.result.gate == "off"
    assert any("never as calm" in w for w in result.result.warnings)
    assert normalised(result) < 4.0
    # where a gyro saturates, only the gate keeps what it missed out
    clipped = launched(*TACTICAL, "--gyro-range", "200", duration=38)
    assert aligned(clipped, **SAID).result.status == "failed"


@pytest.mark.slow
def test_fixes_without_velocity():
    result = aligned(launched(*TACTICAL, "--no-velocity", duration=140))
    assert result.result.vectors == "pos"
    assert result.result.status in ("ok", "degraded")
    assert normalised(result) < 4.0
    with pytest.raises(AlignmentError, match="needs GNSS velocity"):
        aligned(
            launched(*TACTICAL, "--no-velocity", duration=140),
            in_flight={"align_start": 60.0, "align_end": 90.0},
        )


@pytest.mark.slow
def test_fixes_without_height():
    some = aligned(launched(*TACTICAL, "--gnss-flat", "45:60"))
    assert some.result.status == "ok"
    assert normalised(some) < 5.0
    assert any("missing for" in w for w in some.result.warnings)
    # Taken as level though it climbs: the answer is worse, and says so.
    none = aligned(launched(*TACTICAL, "--gnss-flat", "0:90"))
    assert none.result.status != "ok"
    assert any("no vertical velocity" in w for w in none.result.warnings)
    assert any("inconsistent" in w for w in none.result.warnings)


@pytest.mark.slow
def test_gaps():
    short = aligned(launched(*TACTICAL, "--gnss-outage", "45:65"))
    assert short.result.status == "ok"
    assert normalised(short) < 5.0
    long = aligned(launched(*TACTICAL, "--gnss-outage", "50:115", duration=150))
    assert long.result.start_s >= 115.0  # and when the roll after is over
    assert total(long) < 1.0


# -- what cannot be seen ---------------------------------------------------------------------


def level_only(result):
    """Tilt right, and no heading anywhere in the answer."""
    printed = result.result.to_json()
    assert printed["status"] == "level-only"
    assert printed["q_nb_wxyz"] is None and printed["cov_deg2"] is None
    assert printed["heading_deg"] is None and printed["sigma_deg"][2] is None
    assert printed["truth"]["total_deg"] is None and printed["truth"]["error_deg"][2] is None
    assert np.abs(printed["truth"]["error_deg"][:2]).max() < 0.3
    assert any("heading is not known" in w for w in printed["warnings"])


@pytest.mark.slow
def test_at_rest_and_straight_there_is_no_heading():
    pad = launched(*TACTICAL, "--pad", "60", duration=20)
    level_only(aligned(pad, input={"end": "55"}))
    level_only(aligned(pad, method="quest", input={"end": "12"}, in_flight={"refine": "none"}))
    straight = launched(*TACTICAL, "--straight")
    span = {"gate": "off", "align_start": 45, "align_end": 65}
    level_only(aligned(straight, in_flight=span, **SAID))


@pytest.mark.slow
def test_no_heading_with_a_large_sigma_is_ever_given():
    log = launched(*TACTICAL)
    for end in (50.3, 52.0, 56.0, 64.0, 80.0):
        printed = aligned(log, in_flight={"align_end": end, "align_start": 40.0}).result.to_json()
        if printed["q_nb_wxyz"] is not None:
            assert printed["sigma_worst_deg"] <= 5.0
            assert printed["truth"]["total_deg"] < 4.0 * printed["sigma_worst_deg"]


@pytest.mark.slow
def test_too_short_or_too_late():
    log = launched(*TACTICAL)
    brief = {"align_start": 60.0, "align_end": 66.0, "gate": "off"}
    with pytest.raises(AlignmentError, match="needs GNSS velocity for 10 s"):
        aligned(log, in_flight=brief)
    with pytest.raises(AlignmentError, match="no GNSS fix lies within"):
        aligned(launched(*TACTICAL, "--gnss-outage", "0:50"), input={"end": "45"})
    # the gate never opens
    result = aligned(log, in_flight={"gate": "paper", "t_set1": 500.0}, truth=None).result.to_json()
    assert result["status"] == "failed"
    assert result["q_nb_wxyz"] is None and result["roll_deg"] is None
    assert any("the gate waits 500 s" in w for w in result["warnings"])


# -- what the page shows ---------------------------------------------------------------------


def test_error_course_is_that_of_the_answer():
    result = aligned(launched(*TACTICAL))
    course, answer = result.error, result.answer
    assert isinstance(answer, InFlightAlignment)
    np.testing.assert_allclose(
        np.rad2deg(course.final[-1]), result.result.truth.error_deg, atol=2e-3
    )
    assert np.nanmax(np.abs(course.series[-50:])) < np.deg2rad(1.0)
    assert len(course.seconds) == len(course.sigma_worst)
    assert course.seconds[0] >= 40.0 and course.seconds[-1] == pytest.approx(90.0, abs=0.2)


def test_tilt_errors_are_those_of_small_rotations_whatever_the_heading():
    true = rotation.from_euler(np.deg2rad([[10.0, -20.0, 130.0]]))
    psi = np.array([[2e-4, -3e-4, 0.0]])
    turned = rotation.multiply(rotation.exp([[0.0, 0.0, 1.2]]), true)
    for heading in (true, turned):
        result = rotation.multiply(rotation.exp(psi), heading)
        np.testing.assert_allclose(tilt_errors(result, true), psi[:, :2], atol=1e-7)
    np.testing.assert_allclose(errors(rotation.multiply(rotation.exp(psi), true), true), psi)


# -- receivers whose velocities are off for a minute ---------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("model", ["coloured", "launch"])
def test_heading_is_as_certain_as_lasting_errors_of_velocities_allow(tmp_path, model):
    """They counted as white: headings were off by 3.1 sigmas, root mean square, status 0."""
    off = []
    for seed in range(200, 210):
        options = ["--grade", "navigation", "--gnss-model", model, "--seed", str(seed)]
        path = simulated(
            tmp_path / "in.mcap", "drive", *options, "--duration", "240", "--overwrite"
        )
        config = build(ProcessConfig, {"align": {"align": "svd"}})
        found = align_log(path, config, truth="/truth/imu").result
        assert found.status == "ok"
        off.append(found.truth.error_deg[2] / found.sigma_deg[2])
    # beyond 1.72 by chance once in a thousand such sets
    assert np.sqrt(np.mean(np.square(off))) < 1.72
