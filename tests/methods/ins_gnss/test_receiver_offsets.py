"""Latency and lever arm by scores: what bad fixes and the prior do to the answer."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.streams import take_rows
from sinstool.methods.ins_gnss import receiver_offsets
from sinstool.methods.ins_gnss.offset_scores import _FAR, OffsetScores
from sinstool.methods.ins_gnss.receiver_offsets import (
    LEAST_ARM_SIGMA_M,
    LEAST_EPOCHS,
    LEAST_LATENCY_SIGMA_S,
    ReceiverOffsets,
    estimate_offsets,
    settle,
    solved_offsets,
)
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.receiver_priors import ARM_UNKNOWN_M, LATENCY_S
from tests.methods.ins_gnss.flown import Flown


def scores(nis, rows=6.0, latency=0.05, weight=400.0):
    """Epochs a second apart that each say `latency` with `weight`, 1/s^2."""
    n = len(nis)
    information = np.tile(np.diag([weight, 1e-3, 1e-3, 1e-3]), (n, 1, 1))
    score = np.tile([weight * latency, 0.0, 0.0, 0.0], (n, 1))
    many = np.full(n, rows)
    none = np.zeros(n, bool)
    seconds = np.arange(n, dtype=np.int64) * 10**9
    return OffsetScores(
        seconds,
        information,
        score,
        np.asarray(nis),
        many,
        np.zeros((n, 3, 4, 4)),
        np.zeros((n, 2)),
        ~none,
        none,
    )


def test_no_epoch_weighs_more_than_usual_ones():
    """Huber's weight: 1 up to three times what is usual, then as one over the size."""
    nis = np.full(40, 24.0)  # twice as large as noise explains
    nis[7], nis[8] = 24.0 * 2.9**2, 24.0 * 300.0**2
    plain = scores(nis)
    robust = plain.robust
    weight = np.ones(40)
    weight[8] = _FAR / 300.0
    np.testing.assert_allclose(robust.nis, plain.nis * weight)
    np.testing.assert_allclose(robust.rows, plain.rows * weight)
    np.testing.assert_allclose(robust.score, plain.score * weight[:, None])
    np.testing.assert_allclose(robust.information, plain.information * weight[:, None, None])
    # Where the usual innovation is smaller than the filter expects, one of its sigmas is usual
    small = scores(np.where(np.arange(40) == 8, 6.0 * 2.9**2, 0.06)).robust
    np.testing.assert_array_equal(small.rows, 6.0)


def test_a_bad_fix_hardly_moves_the_latency():
    good = scores(np.full(400, 6.0))
    good.score[200, 0] += 400.0 * 30.0  # says 30 s
    good.nis[200] = 400.0 * 30.0**2
    usual = np.zeros(4)
    latency, covariance, _ = solved_offsets(good, usual, usual, 1.0)
    assert latency[0] == pytest.approx(0.05, abs=0.01)
    # The prior, 0.2 s, has no say beside 400 epochs of 0.05 s each
    assert np.sqrt(covariance[0, 0]) < 0.1 * LATENCY_S


@pytest.mark.parametrize("excess", [1.0, 4.0, 25.0])
def test_innovations_beyond_what_is_expected_make_offsets_that_much_less_certain(excess):
    """Against least squares: what is observed of each epoch, and a prior beside it."""
    random = np.random.default_rng(8)
    true = np.array([0.08, 1.5, -0.7, 0.4])
    design = random.standard_normal((400, 6, 4)) * [300.0, 3.0, 3.0, 3.0]
    seen = design @ true + np.sqrt(excess) * random.standard_normal((400, 6))
    plain = scores(np.sum(seen**2, axis=1))
    made = replace(
        plain,
        information=np.swapaxes(design, 1, 2) @ design,
        score=np.einsum("kij,ki->kj", design, seen),
    )
    found, covariance, misfit = solved_offsets(made, np.zeros(4), np.zeros(4), ARM_UNKNOWN_M)
    assert misfit == pytest.approx(excess, rel=0.1)
    prior = np.diag(1.0 / np.array([LATENCY_S, *[ARM_UNKNOWN_M] * 3]))
    rows = np.concatenate([design.reshape(-1, 4) / np.sqrt(excess), prior])
    right = np.concatenate([seen.ravel() / np.sqrt(excess), np.zeros(4)])
    np.testing.assert_allclose(found, np.linalg.lstsq(rows, right)[0], rtol=1e-3)
    white = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    # added to it is what no offset is known better than; it counts scatter between stretches too
    sigma = np.sqrt(
        np.diag(covariance) - np.square([LEAST_LATENCY_SIGMA_S, *[LEAST_ARM_SIGMA_M] * 3])
    )
    assert np.all(sigma > 0.95 * white) and np.all(sigma < 1.5 * white)


@pytest.mark.parametrize("count", [LEAST_EPOCHS - 1, LEAST_EPOCHS])
def test_a_few_epochs_give_no_offsets(monkeypatch, count):
    made = scores(np.full(count, 6.0))
    # That of the gyros says nothing
    information = np.pad(made.information, ((0, 0), (0, 1), (0, 1)))
    made = replace(made, information=information, score=np.pad(made.score, ((0, 0), (0, 1))))
    monkeypatch.setattr(receiver_offsets, "offset_scores", lambda *_: made)
    found = estimate_offsets(None, Settings(), [], None)
    assert (found is None) == (count < LEAST_EPOCHS)


@pytest.mark.parametrize(
    ("off", "sigma", "contradicts"),
    [
        # Each axis within 0.3 m, and 0.41 m off: a phone's chip tilted by 2.7 deg for it
        ([-0.27, 0.14, 0.27], 0.03, True),
        ([-0.2, 0.1, 0.15], 0.03, False),
        ([-0.27, 0.14, 0.27], 0.1, False),
        ([0.0, 0.0, 0.35], 0.03, True),
        ([3.0, 0.0, 0.0], 1.2, False),
    ],
)
def test_an_arm_contradicts_by_its_length(off, sigma, contradicts):
    arm = receiver_offsets.ReceiverOffsets(
        0.0, np.array(off), np.eye(4), np.array(off), np.full(3, sigma), np.zeros((3, 4, 4)), 1.0
    )
    assert arm.arm_contradicts == contradicts


def shown(latency, sigma, misfit, rows):
    covariance = np.diag([sigma**2, 1.0, 1.0, 1.0])
    none = np.zeros(3)
    return ReceiverOffsets(
        latency, none, covariance, none, np.ones(3), np.zeros((3, 4, 4)), misfit, misfit, rows
    )


@pytest.mark.parametrize(
    ("rejected", "misfit", "found"), [(0.03, 2.4, True), (0.2, 2.4, False), (0.0, 0.9, False)]
)
def test_a_latency_that_false_fixes_hide_is_looked_for_without_them(rejected, misfit, found):
    """With many rejected, a wrong latency may be the reason; with none, false fixes are not."""
    rows = 1000.0
    asked = []

    def evaluate(latency, arm_b, gated):
        asked.append(gated)
        if gated:
            return shown(0.2, 0.04, 0.7, (1.0 - rejected) * rows)
        return shown(0.05, 0.06, misfit, rows)

    used, offsets, agrees = settle(evaluate, 0.0)
    assert agrees is found
    assert offsets.latency_s == (0.2 if found else 0.05)
    assert used == pytest.approx(0.2 if found else 0.0)
    assert any(asked) is (misfit > 1.0)


@pytest.mark.parametrize("rows", [7, 400, 1100])
def test_it_does_not_matter_where_parts_of_a_log_end(rows):
    """Means of attitude and velocity over seconds ended with each part that was read at once."""
    flown = Flown(duration=120.0)
    every = flown.increments
    parts = [take_rows(every, slice(k, k + rows)) for k in range(0, len(every.time_ns), rows)]
    settings = flown.using("markov-27")
    one, other = (
        estimate_offsets(flown.start, settings, some, flown.gnss) for some in ([every], parts)
    )
    assert other.latency_s == pytest.approx(one.latency_s, rel=1e-6)
    np.testing.assert_allclose(other.arm_b, one.arm_b, rtol=1e-6)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-6)
