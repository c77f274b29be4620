import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.alignment.inflight_types import AlignmentSettings
from sinstool.methods.alignment.pairs import total_sums
from sinstool.methods.alignment.solution import Segment, course, make_pairs, solve, sums_so_far
from sinstool.simulation.gnss import Receiver
from tests.methods.alignment.launches import NOISY, noisy
from tests.methods.alignment.segments import segment_of

BETWEEN = Receiver(errors=NOISY, offset_s=0.0173)


def one(kind, **changes):
    _, imu, gnss = noisy(3, BETWEEN)
    segment = segment_of(imu, gnss, 40.0)
    sigma = 0.1 * (1.0 + 0.5 * np.sin(np.arange(len(segment))))
    level = 0.1 * (1.0 + 0.5 * np.cos(np.arange(len(segment)) / 40.0))
    segment = Segment(**{**vars(segment), "sigma": sigma, "level": level})
    return segment, AlignmentSettings(vectors=kind, gate="off", **changes)


def angle_deg(a, b):
    return np.rad2deg(2.0 * np.arcsin(np.linalg.norm(a - b, axis=(-2, -1)) / np.sqrt(8.0)))


@pytest.mark.parametrize("fade_s", [np.inf, 30.0])
@pytest.mark.parametrize("kind", ["win", "int", "cen", "diff", "diffc"])
def test_running_is_the_same_as_at_once(kind, fade_s):
    segment, settings = one(kind, fade_s=fade_s)
    running = sums_so_far(segment, settings)
    path = course(segment, settings)
    for end in (60, 300, len(segment) - 1):
        part = segment.take(slice(0, end + 1))
        pairs = make_pairs(part, settings)
        fade = np.inf if kind == "cen" else fade_s
        total = total_sums(pairs, part.rows.time_s, part.sigma, fade)
        for name in ("profile", "second", "noise", "errors"):
            ours, theirs = getattr(running, name)[end], getattr(total, name)
            size = np.abs(theirs).max(axis=(-2, -1), keepdims=True)
            assert np.abs(ours - theirs).max() < 1e-9 * size.max(), name
        solution = solve(part, settings)
        at = int(np.searchsorted(path.rows, end))
        assert path.rows[at] == end
        # Rounding, times how badly the turn about the mean force is known: early, and in
        # vectors that all point alike, as those from the start do.
        limit = 5e-12 if end > 300 and kind == "win" else 1e-10
        assert angle_deg(path.dcm[at], solution.dcm) < limit


@pytest.mark.parametrize("kind", ["win", "int", "cen", "diffc"])
def test_noise_by_its_definition(kind):
    # The whole linear map from the noise of the fixes to sum w alpha x d_beta, as a matrix.
    segment, settings = one(kind, fade_s=25.0)
    segment = segment.take(slice(0, 70))
    pairs = make_pairs(segment, settings)
    count = len(segment)
    weight = pairs.weight
    if kind != "cen":
        weight = weight * np.exp((segment.rows.time_s - segment.rows.time_s[-1]) / 25.0)
    gain = np.zeros((3, count, 3))
    for j in range(len(pairs)):
        x, y, z = weight[j] * pairs.scale[j] * pairs.alpha[j]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        gain[:, pairs.newer[j]] += cross
        if pairs.older[j] >= 0:
            gain[:, pairs.older[j]] -= cross
    expected = np.einsum("ikx,k,jkx->ij", gain, segment.sigma**2, gain)
    noise = sums_so_far(segment, settings).noise[-1]
    ours = np.trace(noise) * np.eye(3) - noise
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_masked_pairs():
    segment, _ = one("win")
    calm = np.zeros(len(segment), dtype=int)
    calm[300:] = 7
    masked = Segment(**{**vars(segment), "not_calm": calm})
    pairs = make_pairs(masked, AlignmentSettings(gate="mask"))
    np.testing.assert_array_equal(
        np.flatnonzero(pairs.weight == 0.0), [*range(20), *range(300, 320)]
    )
    assert sums_so_far(masked, AlignmentSettings(gate="mask")).count[-1] == len(segment) - 40


def test_weights_of_the_fixes():
    segment, settings = one("win")
    pairs = make_pairs(segment, settings)
    k = 100
    s2 = segment.level[k] ** 2 + segment.level[k - 20] ** 2
    assert pairs.weight[k] == pytest.approx(2 * 0.1**2 / s2)
    np.testing.assert_array_equal(
        pairs.alpha[k], segment.rows.alpha[k] - segment.rows.alpha[k - 20]
    )


def test_rotating_the_body_axes_changes_nothing_but_them():
    segment, settings = one("win")
    turn = rotation.normalise([0.3, -0.5, 0.7, 0.2])
    c = rotation.to_dcm(turn)
    rows = segment.rows
    turned = type(rows)(**{**vars(rows), "alpha": rows.alpha @ c.T})
    other = Segment(**{**vars(segment), "rows": turned})
    assert angle_deg(solve(other, settings).dcm @ c, solve(segment, settings).dcm) < 1e-11
