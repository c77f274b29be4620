"""White noise of fixes from their innovations: adapted, and measured by the gate."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.ins_gnss.settings import DivergenceControl
from sinstool.simulation.gnss import GnssErrors, GnssFaults, Jump
from tests.methods.ins_gnss.flown import Flown, joined

NO_GATE = DivergenceControl(gate_probability=1.0)


def noisier(flown, times, begin, end, seed=5):
    """Fixes with white noise so many times that of WHITE within these seconds."""
    random = np.random.default_rng(seed)
    gnss = flown.gnss
    t = (gnss.time_ns - flown.flight.time_ns[0]) * 1e-9
    more = np.sqrt(times**2 - 1.0) * ((t >= begin) & (t < end))[:, None]
    noise = more * random.standard_normal((len(t), 6)) * [1.0, 1.0, 1.5, 0.05, 0.05, 0.08]
    return t, replace(
        gnss,
        latitude=gnss.latitude + noise[:, 0] / 6.37e6,
        longitude=gnss.longitude + noise[:, 1] / (6.37e6 * np.cos(gnss.latitude)),
        height=gnss.height - noise[:, 2],
        velocity_n=gnss.velocity_n + noise[:, 3:],
    )


@pytest.mark.parametrize("times", [2.0, 3.0, 6.0, 30.0])
def test_the_gate_is_no_worse_than_none_where_fixes_are_noisier_than_told(times):
    flown = Flown(duration=400.0)
    controls = {
        "none": NO_GATE,
        "blind": DivergenceControl(gate_noise_epochs=0),
        "default": DivergenceControl(),
    }
    squares = dict.fromkeys(controls, 0.0)
    for seed in (5, 6, 7):
        t, noisy = noisier(flown, times, 100.0, 300.0, seed)
        for label, control in controls.items():
            run, blocks = flown.run(flown.using(control=control), gnss=noisy)
            squares[label] += float(np.sum(flown.rms(blocks, 100.0)[:2] ** 2))
        assert run.summary.restarts == 0
        ratio = np.sqrt(joined(blocks, "noise_ratio"))
        assert ratio[t < 100.0] == pytest.approx(np.ones_like(ratio[t < 100.0]))
        assert ratio[t > 380.0] == pytest.approx(np.ones_like(ratio[t > 380.0]))
        if times >= 6.0:
            level = np.median(ratio[(t > 180.0) & (t < 300.0)], axis=0)
            assert level == pytest.approx(np.full(6, times), rel=0.5)
            gated = joined(blocks, "gated")
            assert gated[(t > 140.0) & (t < 300.0)].mean() < 0.08
    # a few seconds pass until noise is seen to be noise
    assert squares["default"] < 1.3 * squares["none"]
    assert squares["default"] < squares["blind"]
    if times >= 3.0:
        assert squares["default"] < 0.5 * squares["blind"]


@pytest.mark.parametrize("share", [0.02, 0.15])
def test_outliers_are_no_noise_to_the_gate(share):
    clean = Flown(duration=400.0)
    off = GnssFaults(outlier_fraction=share, outlier_position=100.0, outlier_velocity=5.0)
    flown = Flown(duration=400.0, faults=off)
    run, blocks = flown.run(flown.using())
    outlier = flown.gnss_truth.outlier
    assert not joined(blocks, "used")[outlier].any()
    assert run.summary.epochs_gated <= outlier.sum() + 3
    _, without = clean.run(clean.using())
    assert np.all(flown.rms(blocks, 60.0)[:6] < 1.35 * clean.rms(without, 60.0)[:6])


def test_a_jump_is_no_noise_to_the_gate():
    jump = GnssFaults(jumps=(Jump(200.0, 230.0, (60.0, -40.0, 10.0)),))
    flown = Flown(duration=400.0, faults=jump)
    _, blocks = flown.run(flown.using())
    gated = joined(blocks, "gated")
    assert gated.sum() == 30
    assert joined(blocks, "noise_ratio")[gated].max() < 10.0
    _, blind = flown.run(flown.using(control=DivergenceControl(gate_noise_epochs=0)))
    assert flown.rms(blocks, 60.0) == pytest.approx(flown.rms(blind, 60.0), rel=0.02)


def test_a_filter_begun_anew_believes_the_noise_it_was_told():
    flown = Flown(duration=300.0)
    stated = flown.increments
    kick = np.zeros((len(stated.interval), 3))
    kick[5000] = (60.0, 0.0, 0.0)
    run, blocks = flown.run(
        flown.using(control=DivergenceControl(restart_after=20)),
        increments=replace(stated, velocity_increment=stated.velocity_increment + kick),
    )
    assert run.summary.restarts == 1
    after = np.flatnonzero(joined(blocks, "restarted"))[0] + 1
    assert np.all(joined(blocks, "noise_ratio")[after - 10 : after - 1].max(axis=1) > 1.0)
    assert joined(blocks, "noise_ratio")[after:] == pytest.approx(1.0)


@pytest.mark.parametrize(("adaptive", "least"), [("sage-husa", 2.2), ("innovation", 4.0)])
def test_adaptive_noise_finds_a_bad_receiver(adaptive, least):
    flown = Flown()
    bad = Flown(errors=GnssErrors((6.0, 6.0, 9.0), velocity_white=(0.3, 0.3, 0.48)))
    control = DivergenceControl(adaptive=adaptive, window=40, gate_probability=1.0)
    _, blocks = bad.run(bad.using(control=control))
    ratio = joined(blocks, "measurement_sigma")[-1] / [1.0, 1.0, 1.5, 0.05, 0.05, 0.08]
    assert least < ratio.mean() < 10.01
    _, plain = bad.run(bad.using(control=NO_GATE))
    assert bad.rms(blocks, 100.0)[3:5].sum() < 0.8 * bad.rms(plain, 100.0)[3:5].sum()
    _, good = flown.run(flown.using(control=control))
    ratio = joined(good, "measurement_sigma")[-1] / [1.0, 1.0, 1.5, 0.05, 0.05, 0.08]
    assert ratio == pytest.approx(np.ones(6), abs=0.45)
