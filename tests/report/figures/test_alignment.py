"""Figures of alignments: what they show is what was found."""

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.report.figures.alignment import figures
from tests.helpers.launch_logs import TACTICAL, aligned, launched


def by_key(alignment):
    return {f.key: f for f in figures(alignment, ProcessConfig())}


def test_of_a_flight():
    alignment = aligned(launched(*TACTICAL))
    shown = by_key(alignment)
    assert list(shown) == [
        "heading", "attitude", "sigma", "error", "singular-values", "residuals", "force", "rate",
    ]  # fmt: skip
    series = alignment.answer.series
    worst = next(s for s in shown["sigma"].series if s.name == "worst axis")
    np.testing.assert_allclose(worst.y[-1], np.rad2deg(series.sigma_worst[-1]))
    # no attitude is drawn that is not known
    heading = shown["heading"].series[0].y
    unknown = series.sigma_worst > np.deg2rad(5.0)
    assert unknown.any() and np.isnan(heading[unknown]).all()
    assert abs(heading[-1] - alignment.result.heading_deg) < 1.0
    # the boost is on the figure and not among the calm
    force = shown["force"]
    assert force.series[0].y.max() > 30.0
    assert np.nanmax(force.series[1].y) < 12.0
    assert dict(force.marks) == {
        "start": alignment.result.start_s,
        "stop": alignment.result.stop_s,
    }
    assert force.levels[0][1] == 12.0
    rms = np.sqrt(np.mean(np.sum([s.y**2 for s in shown["residuals"].series], axis=0)))
    np.testing.assert_allclose(rms, alignment.result.residual_rms)
    final = next(s for s in shown["error"].series if s.name == "final answer, down")
    assert abs(final.y[-1] - alignment.result.truth.error_deg[2]) < 2e-3


def test_at_rest_there_are_the_dynamics_alone():
    pad = launched(*TACTICAL, "--pad", "60", duration=20)
    alignment = aligned(pad, method="level", input={"end": "40"})
    shown = by_key(alignment)
    assert list(shown) == ["force", "rate"]
    np.testing.assert_allclose(shown["force"].series[0].y, 9.79, atol=0.05)
    assert not shown["force"].levels
