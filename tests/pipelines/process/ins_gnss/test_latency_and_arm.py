"""Latency and lever arm together: found where a log shows them, and nothing said where it does not.

Logs by another program (`pyins.sim`): fixes of 5 cm, velocities of 5 cm/s where there are any.
"""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.streams import GnssEpochs, take_rows
from sinstool.methods.ins_gnss import offset_scores, receiver_offsets
from sinstool.methods.ins_gnss.fix_velocity import outlying, outlying_innovations
from sinstool.methods.ins_gnss.receiver_offsets import (
    ReceiverOffsets,
    estimate_offsets,
    likeliest,
    settle,
)
from sinstool.methods.receiver_priors import LATENCY_S
from sinstool.pipelines.process.ins_gnss import timing
from tests.helpers.filter_logs import first_start_of, run, start_of
from tests.helpers.unseen_drives import (
    CONSUMER,
    GRADES,
    LEVER,
    T0,
    cruise,
    drive,
    flight,
    record,
    sensor_errors,
    walk,
    with_outliers,
    write,
)
from tests.helpers.unseen_errors import shaken, slower
from tests.helpers.unseen_vehicles import motorcycle, tractor, train

KIND = {"gyro_kind": "mean-rate"}
OF_OFFSETS = {"latency", "lever-arm", "velocity-lag", "latency-used"}


@pytest.fixture(scope="module")
def road():
    return drive(5, 160.0, 20.0)


@pytest.fixture(scope="module")
def calm():
    return flight(3, 200.0)


def logged(folder, truth, seed, **options):
    return write(folder / "log.mcap", record(truth, GRADES["tactical"], seed, **options))


def given(latency=None, arm=LEVER):
    return {"lever_arm": tuple(np.asarray(arm).tolist()), "gnss_latency": latency}


def named(result):
    return {f["kind"]: f for f in result["findings"] if f["kind"] in OF_OFFSETS}


def over_sigma(truth, solution, after_s=60.0):
    """Root mean square of horizontal errors over their sigmas, and that error, m."""
    rows = solution.rows((solution.time_ns - T0) * 1e-9 > after_s)
    seconds = (rows.time_ns - T0) * 1e-9
    error = truth.errors_of(seconds, *rows.position.T, rows.velocity_n, np.eye(3)[None])[:, :2]
    variance = np.einsum("nii->ni", rows.covariance_position_n)[:, :2]
    square = np.mean(np.sum(error**2, axis=1))
    return np.sqrt(square / np.mean(np.sum(variance, axis=1))), np.sqrt(square)


@pytest.mark.slow
def test_straight_on_at_one_speed_shows_nothing(tmp_path):
    truth = cruise(120.0)
    log = logged(tmp_path, truth, 2, gnss_rate=4.0, sigma_v=0.05, latency=0.1)
    align = {"align": "fixed", "initial_attitude": (0.0, 0.05 * 180 / np.pi, 0.7 * 180 / np.pi)}
    # Even of an arm that is not given, nothing is made
    for arm in (LEVER, np.zeros(3)):
        result, solution = run(log, input=dict(KIND), align=align, gnss=given(arm=arm))
        used = result["filter"]["gnss_latency"]
        # At 60 m/s the 0.1 s are 6 m, of which no sigma may be silent
        ratio, error = over_sigma(truth, solution)
        assert error > 5.0 and 0.3 < ratio < 1.0
        assert "latency-uncertain" in {f["kind"] for f in result["findings"]}
        assert used["status"] == "not observable"
        assert used["sigma_s"] is None and result["filter"]["gnss_latency_s"] == 0.0
        assert named(result) == {}


@pytest.mark.slow
def test_right_settings_are_not_contradicted_by_smooth_turns(tmp_path, calm):
    for seed, latency, sigma_v in ((1, 0.0, None), (2, 0.1, 0.05)):
        log = logged(tmp_path, calm, seed, gnss_rate=4.0, sigma_v=sigma_v, latency=latency)
        result, _ = run(log, input=dict(KIND), gnss=given(latency))
        assert result["filter"]["gnss_latency"]["status"] == "given"
        assert named(result) == {}


@pytest.mark.slow
@pytest.mark.parametrize("late", ["fixes", "IMU"])
def test_fixes_that_seem_early_may_show_a_late_imu(tmp_path, road, late):
    """Nothing tells the two apart, so the user learns what it means for the solution."""
    log = logged(tmp_path, road, 4, sigma_v=0.05, latency=0.1 if late == "fixes" else -0.05)
    result, _ = run(log, input=dict(KIND), gnss=given())
    text = named(result)["latency-used"]["text"]
    assert ("the motion of 0.05" in text) == (late == "IMU")


@pytest.mark.slow
@pytest.mark.parametrize("sigma_v", [None, 0.05])
def test_a_drive_shows_its_latency(tmp_path, road, sigma_v):
    log = logged(tmp_path, road, 4, sigma_v=sigma_v, latency=0.1)
    start = start_of(log, input=KIND, gnss=given())
    assert start.latency_status == "found"
    assert abs(start.offsets.latency_s - 0.1) < 3.0 * start.offsets.sigma_s < 0.01
    assert start.settings.gnss_latency == pytest.approx(start.offsets.latency_s, abs=1e-3)
    assert np.all(np.abs(start.offsets.arm_b - LEVER) < 0.1)


@pytest.mark.slow
def test_bad_fixes_change_nothing(tmp_path, road):
    data = record(road, GRADES["tactical"], 6, gnss_rate=4.0, latency=0.1)
    log = write(tmp_path / "log.mcap", with_outliers(data, 6))
    start = start_of(log, input=KIND, gnss=given())
    assert start.latency_status == "found"
    assert start.settings.gnss_latency == pytest.approx(0.1, abs=0.004)
    assert not start.offsets.arm_contradicts


@pytest.mark.slow
def test_an_antenna_two_metres_away_is_named_with_its_place(tmp_path, road):
    log = logged(tmp_path, road, 7, latency=0.1)
    wrong = LEVER + np.array([2.0, 0.0, 0.0])
    result, solution = run(log, input=dict(KIND), gnss=given(arm=wrong))
    finding = named(result)["lever-arm"]
    assert finding["numbers"]["forward_m"] == pytest.approx(-2.0, abs=0.2)
    assert "+-" in finding["text"]
    arm = finding["answer"].removeprefix("add --lever-arm ").split(" if")[0]
    off = np.array([float(x) for x in arm.split(",")]) - LEVER
    assert np.all(np.abs(off) < [0.3, 0.3, 1.2])  # a car hardly leans: 0.5 m (1 sigma)
    # The wrong arm does not become a latency, nor is another one used than was given
    assert result["filter"]["gnss_latency_s"] == pytest.approx(0.1, abs=0.01)
    assert result["filter"]["lever_arm_m"] == pytest.approx(wrong)
    # The solution is where that arm puts it, and its sigmas say how far off that is
    ratio, error = over_sigma(road, solution)
    assert error > 1.5 and 0.7 < ratio < 1.3


@pytest.mark.parametrize(
    ("moving", "latency", "sigma_v"), [(drive, 0.0, 0.05), (drive, 0.1, None), (walk, 0.0, None)]
)
@pytest.mark.slow
def test_an_antenna_of_which_nobody_said_where_it_is_is_found(tmp_path, moving, latency, sigma_v):
    truth = moving(7, 200.0)
    noise = {"sigma": 0.02, "sigma_v": sigma_v, "latency": latency, "gnss_rate": 5.0}
    log = logged(tmp_path, truth, 7, **noise)
    result, solution = run(log, input=dict(KIND))
    finding = next(f for f in result["findings"] if f["kind"] == "lever-arm-used")
    used, shown = result["filter"]["lever_arm_m"], start_of(log, input=KIND)
    assert used == pytest.approx(shown.settings.lever_arm_b) and shown.arm_status == "found"
    sigma = np.sqrt(np.diag(shown.offsets_error)[1:])
    assert np.all(np.abs(used - LEVER) < 3.5 * sigma) and sigma.min() < 0.1
    assert [finding["numbers"][k] for k in ("forward_m", "right_m", "down_m")] == list(used)
    assert "lever-arm" not in named(result)
    # What is not known of it is in the sigmas
    assert over_sigma(truth, solution)[0] < 1.5


@pytest.mark.slow
def test_a_long_rest_before_the_drive_hides_no_antenna(tmp_path):
    truth = drive(8, 540.0, 405.0)
    log = logged(tmp_path, truth, 8, sigma=0.02, sigma_v=0.05, gnss_rate=5.0)
    shown = start_of(log, input=KIND)
    assert shown.arm_status == "found"
    assert shown.settings.lever_arm_b[:2] == pytest.approx(LEVER[:2], abs=0.1)


@pytest.mark.slow
def test_an_antenna_that_somebody_said_is_at_the_imu_stays_there(tmp_path, road):
    log = logged(tmp_path, road, 7, sigma=0.02)
    result, solution = run(log, input=dict(KIND), gnss=given(arm=np.zeros(3)))
    assert result["filter"]["lever_arm_m"] == [0.0, 0.0, 0.0]
    assert "in use" in named(result)["lever-arm"]["text"]
    assert over_sigma(road, solution)[0] < 1.3


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "kind"), [(0.02, "uncertain"), (1.0, "assumed")])
def test_an_antenna_that_nothing_shows_is_anywhere_near_the_imu(tmp_path, sigma, kind):
    truth = cruise(120.0)
    log = logged(tmp_path, truth, 2, gnss_rate=4.0, sigma=sigma)
    align = {"align": "fixed", "initial_attitude": (0.0, 0.05 * 180 / np.pi, 0.7 * 180 / np.pi)}
    result, solution = run(log, input=dict(KIND), align=align, gnss={"gnss_latency": 0.0})
    assert result["filter"]["lever_arm_m"] == [0.0, 0.0, 0.0]
    shown = {"lever-arm-uncertain", "lever-arm-assumed"}
    assert shown & {f["kind"] for f in result["findings"]} == {f"lever-arm-{kind}"}
    variance = np.einsum("nii->n", solution.covariance_position_n[-1:]) / 3.0
    assert kind == "assumed" or 0.5 < np.sqrt(variance[0]) < 1.2
    told, _ = run(log, input=dict(KIND), align=align, gnss=given(0.0))
    assert not shown & {f["kind"] for f in told["findings"]}


@pytest.mark.slow
def test_metres_of_noise_say_nothing_of_an_antenna_and_do_not_care(tmp_path, road):
    log = logged(tmp_path, road, 7, sigma=2.0, gnss_rate=1.0)
    start = start_of(log, input=KIND)
    assert start.arm_status == "open" and not any(start.settings.lever_arm_b)
    assert not start.offsets_error[1:].any()


@pytest.mark.slow
def test_an_arm_much_better_known_than_fixes_are_good_is_in_what_velocities_lack(tmp_path):
    """Of a decimetre that is too little to be used, a lean makes a tenth of a metre a second."""
    truth, arm = motorcycle(2, 160.0), np.array([0.0, 0.0, -0.11])
    noise = {"gnss_rate": 5.0, "sigma": 0.8, "sigma_v": 0.03, "lever": arm}
    log = write(tmp_path / "log.mcap", record(truth, GRADES["tactical"], 2, **noise))
    start = start_of(log, input=KIND, gnss={"gnss_latency": 0.0})
    assert start.arm_status == "open" and not any(start.settings.lever_arm_b)
    sigma = np.sqrt(np.diag(start.offsets_error))
    assert sigma[3] == pytest.approx(0.11, abs=0.04) and sigma[1:].max() < start.fix_sigma_m
    # No such moments of an arm that the log does not show
    unknown = replace(start.offsets, covariance=np.diag([1e-6, 1.0, 1.0, 1.0]))
    coarse = replace(start.settings.gnss, position_markov=(1.2, 1.2, 2.0))
    coarse = replace(start.settings, gnss=coarse)
    assert not replace(start, offsets=unknown, settings=coarse).offsets_error.any()


@pytest.mark.slow
def test_sensors_that_say_little_of_tilt_do_not_raise_or_lower_the_antenna(tmp_path):
    """Fixes tilt a filter of poor sensors towards where they are off, and an antenna with it."""
    sensors = sensor_errors(0.4, 60.0, 0.15, 1000.0, 2000.0, 0.5)
    log = write(tmp_path / "log.mcap", record(drive(31, 250.0, 20.0), sensors, 1))
    offsets = start_of(log, input=KIND, gnss=given(0.0)).offsets
    assert np.all(np.abs(offsets.arm_off_b) < 2.0 * offsets.arm_off_sigma_b)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_a_wrong_latency_is_named(tmp_path, road, wrong):
    """It is used, as it was given, and the sigmas are as large as what comes of it."""
    log = logged(tmp_path, road, 8, latency=0.05)
    result, solution = run(log, input=dict(KIND), gnss=given(wrong))
    finding = named(result)["latency"]
    assert finding["numbers"]["latency_s"] == pytest.approx(0.05, abs=0.005)
    assert "--gnss-latency 0.05" in finding["answer"] or "--gnss-latency 0.04" in finding["answer"]
    assert result["filter"]["gnss_latency_s"] == wrong
    ratio, error = over_sigma(road, solution)
    assert error > 0.3 and 0.5 < ratio < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "named_as"), [(2, "before-start"), (3, "stated-latency")])
def test_a_wrong_latency_that_turns_the_attitude_is_reported(tmp_path, seed, named_as):
    """A walker's velocities of another time fit some heading or other: 24 to 172 deg off.

    Or none but for a part of the log, beyond which the solution is uncertain by hundreds of metres.
    """
    truth = walk(seed, 300.0)
    noise = {"sigma": 0.87, "sigma_v": 0.21}
    data = record(truth, GRADES["tactical"], seed, gnss_rate=5.0, latency=0.2, **noise)
    log = write(tmp_path / "log.mcap", data)
    result, solution = run(log, input=dict(KIND), gnss=given(0.0))
    told = next(f for f in result["findings"] if f["kind"] == named_as)
    assert told["severity"] == "lost"
    if named_as == "stated-latency":
        assert told["numbers"]["attitude_deg"] > 5.0
    else:
        assert over_sigma(truth, solution)[0] < 1.5
    assert named(result)["latency"]["numbers"]["latency_s"] == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [0.9, -2.0])
def test_fixes_of_another_time_that_no_latency_explains_are_reported(tmp_path, ahead):
    """Some latency is found, with an antenna elsewhere and a heading that is anything."""
    truth = walk(1, 300.0)
    noise = {"sigma": 0.3, "sigma_v": 0.1}
    data = record(truth, GRADES["tactical"], 1, gnss_rate=5.0, latency=0.1, **noise)
    log = write(tmp_path / "log.mcap", data)
    for offset, doubted in ((0.0, False), (ahead, True)):
        shift = {**KIND, "gnss_clock_offset": offset}
        result, _ = run(log, input=shift, gnss=given())
        told = {f["kind"]: f for f in result["findings"] if f["severity"] == "lost"}
        assert ("velocities-do-not-fit" in told) == doubted
        assert doubted or not told


@pytest.mark.slow
def test_what_the_filter_assumes_does_not_matter(tmp_path, calm):
    """Latency and arm are what they are, whatever those are about which they are looked for."""
    log = logged(tmp_path, calm, 9, gnss_rate=4.0, sigma_v=0.05, latency=0.1)
    answers = []

    def about(begin, settings, parts, gnss, assumed, _):
        for latency, away in ((0.1, 0.0), (0.11, 0.0), (0.1, 0.2)):
            arm = tuple((LEVER + away).tolist())
            here = replace(settings, gnss_latency=latency, lever_arm_b=arm)
            answers.append(estimate_offsets(begin, here, parts, gnss, LEVER))
        return

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "estimate_offsets", about)
        start_of(log, input=KIND, gnss=given(0.1))
    first = answers[0]
    assert first.latency_s == pytest.approx(0.1, abs=3.0 * first.sigma_s)
    for other in answers[1:3]:
        assert other.latency_s == pytest.approx(first.latency_s, abs=0.3 * first.sigma_s)
        apart = np.abs(other.arm_off_b - first.arm_off_b)
        assert np.all(apart < 0.3 * first.arm_off_sigma_b + 0.01)
        assert np.allclose(other.covariance, first.covariance, rtol=0.2, atol=1e-4)


def offsets_at(latency, sigma):
    covariance = np.diag([sigma**2, 0.01, 0.01, 0.01])
    return ReceiverOffsets(
        latency, np.zeros(3), covariance, np.zeros(3), np.full(3, 0.1), np.zeros((3, 4, 4))
    )


def test_what_was_given_is_right_until_the_log_contradicts_it():
    shown = offsets_at(0.05, 0.005)
    assert not shown.error_of(0.06, configured=True).any()
    wrong = shown.error_of(0.3, configured=True)
    assert wrong[0, 0] == pytest.approx(0.25**2 + 0.005**2) and np.count_nonzero(wrong) == 1
    assert shown.error_of(0.05, configured=False)[0, 0] == pytest.approx(0.005**2)
    arm = replace(shown, arm_off_b=np.array([2.0, 0.0, 0.1]))
    both = arm.error_of(0.05, configured=True)
    assert both[1, 1] == pytest.approx(4.0 + 0.01) and both[1, 3] == pytest.approx(0.2)
    assert not both[0].any()
    # What the log hardly shows is known no worse than latencies are
    hardly = replace(offsets_at(0.0, 0.1), spread=10.0)
    assert hardly.error_of(0.0, configured=False)[0, 0] == pytest.approx(LATENCY_S**2)


@pytest.mark.parametrize(
    ("square", "sigmas"),
    # A quarter of rows times the relative increase, 1000 * (0.84 / 0.75 - 1), is 30
    [(0.84, np.sqrt(30.0)), (0.76, 2.0), (0.6, 2.0), (6.0, 8.0)],
)
def test_fixes_that_are_far_less_likely_with_a_given_latency_deny_it(square, sigmas):
    """A told 0.3 s stood, and positions were 75 sigmas off: 36 +- 140 ms denied nothing."""
    follows = replace(offsets_at(0.04, 0.0325), spread=4.0, square=0.75, rows=1000.0)
    denies = follows.against(0.3, square)
    assert denies.sigma_s == pytest.approx(0.26 / sigmas)
    assert denies.latency_contradicts(0.3) == (square > 0.8)


def test_steps_lead_to_the_latency_that_is_its_own_estimate():
    tried = []

    def far(latency, _, gated):
        tried.append((latency, gated))
        return offsets_at(-0.14 + 0.4 * (latency + 0.14), 0.005)

    used, offsets, agrees = settle(far, 0.0)
    assert agrees and used == pytest.approx(-0.14, abs=2e-3)
    assert len(tried) <= 6 and tried[-1][1] and not tried[0][1]
    assert offsets.latency_s == pytest.approx(used, abs=2e-3)


@pytest.mark.parametrize("truth", [0.0, 0.03])
def test_an_estimate_that_follows_what_is_used_is_known_the_less(truth):
    def follows(latency, *_):
        return offsets_at(truth + 0.75 * (latency - truth), 0.007)

    used, offsets, agrees = settle(follows, 0.0)
    assert agrees and abs(used - truth) < 0.007
    assert offsets.sigma_s == pytest.approx(4.0 * 0.007)
    _, offsets, _ = settle(lambda *_: offsets_at(truth, 0.007), 0.0)
    assert offsets.sigma_s == pytest.approx(0.007)


def test_an_estimate_that_creeps_on_with_what_is_used_is_known_the_less():
    """By 1.4 ms a round, at a sigma of 1.8: 21 ms were used, at 12 sigmas, where 0 was true."""

    def creeps(latency, *_):
        return offsets_at(latency - 0.0014, 0.0018)

    used, offsets, _ = settle(creeps, 0.0)
    assert abs(used) < 2.0 * offsets.sigma_s
    assert not offsets.latency.differs_from(0.0, timing.LEAST_S, timing.USED)


def test_an_estimate_that_runs_away_is_said_not_to_agree():
    used, offsets, agrees = settle(lambda latency, *_: offsets_at(latency + 0.1, 0.002), 0.0)
    assert not agrees and offsets.latency_s == pytest.approx(used + 0.1)
    used, _, agrees = settle(lambda latency, *_: offsets_at(latency, 0.1), 0.0)
    assert used == 0.0 and not agrees  # not observable
    assert settle(lambda *_: None, 0.02) == (0.02, None, False)


@pytest.mark.parametrize("rows", [40.0, 2700.0])
def test_estimates_that_lead_away_from_the_likeliest_latency_are_not_used(rows):
    """Slow motion, innovations that follow each other: 0.54 s was used where 0.08 s was true."""

    def about(latency, *_):
        shown = offsets_at(0.2 + 0.65 * latency, 0.018)
        square = 0.75 + 0.5 * (latency - 0.08) ** 2
        return replace(shown, square=square, rows=rows, given=False)

    used, offsets, agrees = settle(about, 0.0)
    assert agrees and used > 0.5
    other = likeliest(about, (0.0, used), None)
    if rows < 100.0:  # as likely as any
        assert other is None
        return
    used, offsets = other
    assert used == pytest.approx(0.08, abs=0.03)
    assert offsets.latency_s == pytest.approx(0.08, abs=1e-6)
    assert offsets.sigma_s == pytest.approx(np.sqrt(2.0 / rows), rel=0.05)
    # Nor is another sought where the last one is likelier than those before it
    assert likeliest(about, (0.0, 0.08), None) is None
    assert likeliest(lambda *_: None, (0.0, 0.5), None) is None


@pytest.mark.parametrize("seed", range(5))
def test_rough_squares_show_a_latency_as_far_as_they_are_no_larger(seed):
    """A cable car's ran away to 0.97 s, as no parabola was found through what each epoch moves."""
    random = np.random.default_rng(seed)
    rough: dict[float, float] = {}

    def about(latency, *_):
        shown = offsets_at(0.1 + 0.9 * latency, 0.02)
        square = 0.6 + 0.1 * abs(latency) + rough.setdefault(latency, 0.004 * random.random())
        return replace(shown, square=square, rows=9500.0, given=False)

    used, offsets = likeliest(about, (0.0, 0.92), None)
    assert abs(used) < 0.05 and abs(used) < 3.0 * offsets.sigma_s < 0.3
    assert offsets.latency_s == pytest.approx(used, abs=2.0 * offsets.sigma_s)


def test_where_all_fixes_would_be_left_out_none_is():
    def bad_start(latency, _, gated):
        return None if gated else offsets_at(0.1 + 0.1 * (latency - 0.1), 0.001)

    used, offsets, agrees = settle(bad_start, 0.0)
    assert agrees and used == pytest.approx(0.1, abs=1e-3)
    assert offsets.latency_s == pytest.approx(0.1, abs=1e-3)


@pytest.mark.slow
def test_a_calm_flight_that_hardly_shows_its_latency_says_so(tmp_path):
    """Estimates stay near the latency they were made about, which is no reason to believe it."""
    truth = flight(3, 150.0)
    ratios = []
    for draw in (22, 24):
        data = record(truth, CONSUMER, draw, gnss_rate=10.0, sigma=0.02, sigma_v=0.075)
        log = write(tmp_path / "log.mcap", data)
        start = start_of(log, input=KIND, gnss=given())
        ratios.append(start.settings.gnss_latency / np.sqrt(start.offsets_error[0, 0]))
    assert np.max(np.abs(ratios)) < 2.5


@pytest.mark.slow
def test_rough_air_of_a_start_by_positions_alone(tmp_path):
    """Its attitude is off by several sigmas, so that at first nearly no fix is believed."""
    truth = flight(2, 200.0, turbulent=True)
    for latency in (0.0, 0.1):
        log = logged(tmp_path, truth, 2006, gnss_rate=4.0, latency=latency)
        start = start_of(log, input=KIND, gnss=given())
        assert start.latency_status == "found"
        assert abs(start.settings.gnss_latency - latency) < 3.0 * start.offsets.sigma_s < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4])
def test_a_start_with_a_wrong_latency_does_not_hold_it_back(tmp_path, seed):
    """It was compared with the latency found by its own attitude: half of it, 9 sigmas off."""
    data = record(flight(seed, 300.0, turbulent=True), GRADES["tactical"], 1000 * seed, latency=0.1)
    arm = LEVER + 0.1 * np.random.default_rng(1000 * seed).standard_normal(3)
    start = start_of(write(tmp_path / "log.mcap", data), input=KIND, gnss=given(arm=arm))
    assert start.settings.gnss_latency == pytest.approx(0.1, abs=3.0 * start.offsets.sigma_s)
    assert start.offsets.sigma_s < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("moving", "seed"), [(train, 2), (train, 3), (drive, 3)])
def test_a_shaken_antenna_hides_no_latency(tmp_path, moving, seed):
    """About wrong latencies antennas elsewhere explain how it shakes; 36 to 88 ms were believed."""
    data = record(
        moving(seed, 300.0), CONSUMER, seed, gnss_rate=10.0, sigma=0.3, sigma_v=0.05, latency=0.2
    )
    log = write(tmp_path / "log.mcap", slower(shaken(data, seed, 1.0, 0.02), 4))
    start = start_of(log, input=KIND, gnss=given())
    assert start.latency_status == "found"
    assert abs(start.settings.gnss_latency - 0.2) < 5e-3
    assert not start.offsets.arm_contradicts


@pytest.mark.slow
@pytest.mark.parametrize(("moving", "seed"), [(drive, 1), (drive, 3), (tractor, 1)])
def test_an_antenna_on_a_vehicle_that_an_engine_shakes_is_where_it_is(tmp_path, moving, seed):
    """No receiver follows what the gyros feel of an engine: arms were too short by up to 2 m."""
    noise = {"gnss_rate": 5.0, "sigma": 0.02, "sigma_v": 0.03, "latency": 0.1}
    data = record(moving(seed, 160.0), GRADES["tactical"], seed, **noise)
    log = write(tmp_path / "log.mcap", shaken(data, seed, 0.5, 0.1))
    first, motion = first_start_of(log, input=KIND, gnss=given(0.1))
    shown = estimate_offsets(first.start, first.settings, [motion], first.used)
    assert np.all(np.abs(shown.arm_off_b) < 3.0 * shown.arm_off_sigma_b)
    assert not shown.arm_contradicts and shown.sigma_s < 0.006


@pytest.mark.parametrize(
    ("estimates", "along"),
    [
        ([(0.0, 0.002), (0.002, -0.013), (-0.05, -0.07), (-0.12, -0.12)], True),
        ([(0.0, 0.07), (0.07, 0.095), (0.1, 0.1)], False),
        ([(0.0, 0.004), (0.004, 0.005)], False),  # noise
        ([(0.1, 0.101)], False),
    ],
)
def test_estimates_that_go_where_they_are_led_are_doubted(estimates, along):
    """Each next to the latency before, as a gate had left out what contradicts: 0.2 s was true."""
    made = [(about, offsets_at(latency, 0.003)) for about, latency in estimates]
    assert timing.Estimates(made=made).followed_assumption == along


@pytest.mark.parametrize(
    ("estimates", "doubtful"),
    [
        # Towards 0.1 s, each nearer by less; then the same at 0.1 s, where noise is all there is
        ([(0.0, 0.07), (0.07, 0.095), (0.1, 0.1)], False),
        ([(0.1, 0.101), (0.101, 0.1)], False),
        ([(0.0, -0.024), (-0.024, 0.022), (0.02, 0.018)], True),  # back by more than it went
        ([(0.0, 0.05), (0.05, 0.17)], True),  # further than it went
    ],
)
def test_estimates_that_lead_nowhere_are_doubted(estimates, doubtful):
    tried = [(about, offsets_at(latency, 0.002)) for about, latency in estimates]
    assert timing.Estimates(tried=tried).doubtful == doubtful
    last = replace(tried[-1][1], misfit=5.0)
    assert timing.Estimates(tried=[*tried, (last.latency_s, last)]).doubtful


def test_a_filter_that_diverges_shows_no_offsets(tmp_path, road, monkeypatch):
    """Unless fixes far off are left out, wild corrections may make it worse with each fix."""
    log = logged(tmp_path, road, 4, gnss_rate=4.0)
    first, motion = first_start_of(log, input=KIND, gnss=given())
    shown = estimate_offsets(first.start, first.settings, [motion], first.used)
    assert shown is not None and shown.observable
    # A wild one is off by 1e40 for each second; this one by no more than the vehicle's speed
    monkeypatch.setattr(offset_scores, "_MOST_OFF", 1.0)
    assert estimate_offsets(first.start, first.settings, [motion], first.used) is None


@pytest.mark.slow
def test_a_latency_that_does_not_converge_is_reported(tmp_path, road, monkeypatch):
    log = logged(tmp_path, road, 4)

    def never(begin, settings, parts, gnss, assumed=None, given=True):
        return offsets_at(settings.gnss_latency + 0.05, 0.002)

    monkeypatch.setattr(timing, "estimate_offsets", never)
    monkeypatch.setattr(receiver_offsets, "_ROUNDS", 1)
    start = start_of(log, input=KIND, gnss=given())
    assert start.latency_status == "not settled"
    (said,) = [text for text in start.warnings if "did not converge" in text]
    assert "--gnss-latency" in said
    # Any latency that was tried may be it: 0, 0.05 and 0.1 s
    assert start.offsets.sigma_s == pytest.approx(0.05, rel=0.01)


@pytest.mark.slow
def test_sigmas_are_what_errors_are(tmp_path):
    ratios = []
    for seed in range(3):
        for number, truth in enumerate((flight(20 + seed, 200.0), drive(20 + seed, 200.0, 20.0))):
            latency = (0.0, 0.1, 0.2)[seed]
            draw = 100 + 10 * seed + number
            sigma_v = 0.05 if (seed + number) % 2 else None
            log = logged(tmp_path, truth, draw, gnss_rate=4.0, sigma_v=sigma_v, latency=latency)
            arm = LEVER + 0.1 * np.random.default_rng(draw).standard_normal(3)
            offsets = start_of(log, input=KIND, gnss=given(arm=arm)).offsets
            assert offsets.observable and not offsets.arm_contradicts
            ratios.append((offsets.latency_s - latency) / offsets.sigma_s)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.5
    assert np.max(np.abs(ratios)) < 3.0


@pytest.mark.slow
def test_a_piece_of_one_update(tmp_path, calm):
    """A gap may leave a single update before it: that ended in an IndexError."""
    log = logged(tmp_path, calm, 9, latency=0.1)
    answers = []

    def about(begin, settings, parts, gnss, assumed, _):
        one = [take_rows(parts[0], slice(0, 1)), take_rows(parts[0], slice(1, None))]
        for pieces in (parts, [*one, *parts[1:]]):
            answers.append(estimate_offsets(begin, settings, pieces, gnss, assumed))
        return

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "estimate_offsets", about)
        start_of(log, input=KIND, gnss=given(0.1))
    assert abs(answers[1].latency_s - answers[0].latency_s) < 0.2 * answers[0].sigma_s
    assert np.allclose(answers[1].covariance, answers[0].covariance, rtol=0.05, atol=2e-5)


def epochs_of(fixes):
    """Positions of 5 cm, as a filter gets them."""
    n = len(fixes.seconds)
    times = np.round(fixes.seconds * 1e9).astype(np.int64)
    none, sigma = np.full((n, 3), np.nan), np.full((n, 3), 0.05)
    return GnssEpochs(times, times, fixes.latitude, fixes.longitude, fixes.height, none, sigma,
                      none)  # fmt: skip


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_fixes_far_off_their_neighbours_are_seen_before_any_filter(road, rate):
    data = record(road, GRADES["tactical"], 5, gnss_rate=rate, sigma=0.05)
    clean = outlying(epochs_of(data.fixes))
    assert not clean.any()
    spoilt = with_outliers(data, 3, 0.03, 40.0)
    moved_m = np.abs(spoilt.fixes.latitude - data.fixes.latitude) * 6.37e6
    moved_m += np.abs(spoilt.fixes.longitude - data.fixes.longitude) * 4e6
    seen = outlying(epochs_of(spoilt.fixes))
    far = moved_m > 25.0
    assert far.any() and seen[far].all() and not seen[moved_m == 0.0].any()


@pytest.mark.slow
def test_outliers_of_a_slow_receiver_do_not_hide_its_latency(tmp_path):
    """Once a second a turn moves a fix as far off its neighbours: only the IMU tells them apart."""
    data = record(drive(4, 300.0, 20.0), CONSUMER, 4, sigma=0.02, latency=0.1)
    log = write(tmp_path / "log.mcap", with_outliers(data, 4, 0.034, 12.0))
    start = start_of(log, input=KIND, gnss=given())
    assert start.latency_status == "found"
    assert abs(start.offsets.latency_s - 0.1) < 3.0 * start.offsets.sigma_s < 0.1


@pytest.mark.parametrize("innovation_m, far", [(2.0, False), (12.0, True)])
def test_by_the_imu_fixes_are_outliers_that_a_turn_could_explain(innovation_m, far):
    times = np.arange(100) * 1_000_000_000
    nu = np.outer(np.linspace(0.0, 30.0, 100), [1.0, -1.0, 0.2])
    nu[[20, 21, 70], 1] += innovation_m
    nu[90] = np.nan
    shown = np.flatnonzero(outlying_innovations(times, nu, 0.02)).tolist()
    assert (70 in shown) == far and set(shown) <= {20, 21, 70}
    # What changes in a long gap is no outlier
    times[70:] += 20_000_000_000
    assert not outlying_innovations(times, nu, 0.02)[70]


@pytest.mark.parametrize("stated_m, far", [(np.nan, True), (0.01, True), (1.0, False)])
def test_how_far_is_far_off_is_what_the_receiver_says_of_its_noise_and_what_is_usual(stated_m, far):
    # At rest, 10 cm of noise: 3 m off is an outlier but for a receiver that claims no better.
    random, n = np.random.default_rng(3), 200
    times, none = np.arange(n) * 1_000_000_000 // 5, np.full((n, 3), np.nan)
    off = 0.1 * random.standard_normal((n, 2))
    off[77] += [3.0, 0.0]
    gnss = GnssEpochs(times, times, 0.8 + off[:, 0] / 6.37e6, 0.1 + off[:, 1] / 4.4e6,
                      np.full(n, 100.0), none, np.full((n, 3), stated_m), none)  # fmt: skip
    assert np.flatnonzero(outlying(gnss)).tolist() == ([77] if far else [])


@pytest.mark.parametrize("many", [0, 1, 3])
def test_a_few_fixes_have_no_outliers(road, many):
    gnss = epochs_of(record(road, GRADES["tactical"], 5, sigma=0.05).fixes).rows(slice(0, many))
    assert outlying(gnss).tolist() == [False] * many
    assert outlying_innovations(gnss.time_ns, np.zeros((many, 3)), 0.05).tolist() == [False] * many


def test_a_position_held_at_rest_has_no_outliers(road):
    fixes = record(road, GRADES["tactical"], 5, gnss_rate=5.0, sigma=0.05).fixes
    held = fixes.rows(np.maximum(np.arange(len(fixes.seconds)), 100))
    assert not outlying(epochs_of(replace(held, seconds=fixes.seconds))).any()


@pytest.mark.slow
@pytest.mark.parametrize("right", [True, False])
def test_a_wrong_lever_arm_that_turns_the_attitude_is_reported(tmp_path, right):
    """A walker turns quickly about an antenna: 155 deg off at 20 sigmas, status 0."""
    truth = walk(3, 300.0)
    noise = {"sigma": 0.24, "sigma_v": 0.28}
    log = write(tmp_path / "log.mcap", record(truth, GRADES["tactical"], 3, gnss_rate=5.0, **noise))
    arm = LEVER if right else LEVER * [1.0, -1.0, -1.0]
    result, _ = run(log, input=dict(KIND), gnss={"lever_arm": tuple(arm.tolist())})
    told = [f for f in result["findings"] if f["kind"] == "stated-lever-arm"]
    # Beside an arm that is wrong, its turn of the attitude or the fixes that do not fit are told
    assert not (right and told)
    assert any(f["severity"] == "lost" for f in result["findings"]) == (not right)
