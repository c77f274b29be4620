from fractions import Fraction as F

import mpmath
import numpy as np
import pytest

from sinstool.methods.coning.lags import lag_coefficients, solve
from sinstool.methods.coning.registry import algorithm


def over(denominator, *numerators):
    return tuple(F(n, denominator) for n in numerators)


# Miller 1983, Ignagni 1996: weights of the increments 1, 2, .. before the last.
PUBLISHED = {
    (1, 0): (),
    (2, 0): over(3, 2),
    (3, 0): over(20, 27, 9),
    (4, 0): over(105, 214, 92, 54),
    (5, 0): over(504, 1375, 650, 525, 250),
    (6, 0): over(4620, 15797, 7834, 7296, 4558, 2315),
    (1, 1): over(12, 1),
    (1, 2): over(60, 7, -1),
    (1, 3): (F(113, 840), F(-13, 420), F(1, 280)),
    (2, 1): (F(11, 15), F(-1, 30)),
    (2, 2): (F(323, 420), F(-13, 210), F(1, 140)),
    (3, 1): (F(393, 280), F(57, 140), F(3, 280)),
    (3, 2): (F(1207, 840), F(157, 420), F(1, 40), F(-1, 420)),
    (4, 1): (F(656, 315), F(262, 315), F(8, 15), F(-1, 315)),
}

# Leading drift error over theta**2 Omega / 2, in powers of l = Omega * interval.
LEADING = {
    (1, 0): (2, F(1, 6)),
    (2, 0): (4, F(1, 30)),
    (3, 0): (6, F(1, 140)),
    (4, 0): (8, F(1, 630)),
    (5, 0): (10, F(1, 2772)),
    (6, 0): (12, F(1, 12012)),
    (1, 1): (4, F(1, 30)),
    (1, 2): (6, F(1, 140)),
    (1, 3): (8, F(1, 630)),
    (2, 1): (6, F(1, 140)),
    (2, 2): (8, F(1, 630)),
    (3, 1): (8, F(1, 630)),
    (4, 1): (10, F(1, 2772)),
}


@pytest.mark.parametrize("key", PUBLISHED)
def test_published_tables(key):
    assert lag_coefficients(*key) == PUBLISHED[key]


def drift(samples, previous, turn):
    """Drift over theta**2 Omega / 2 by composing high-precision quaternions.

    Increments of coning whose cone is so narrow that only its second order is left, one
    update by the definition of the algorithm, and the angle by which the product of that
    update and the turn of the pattern differs from the turn.
    """
    theta = mpmath.mpf(10) ** -40

    def increment(k):
        middle = (k - mpmath.mpf(1) / 2) * turn
        size = 2 * mpmath.sin(theta) * mpmath.sin(turn / 2)
        z = -2 * turn * mpmath.sin(theta / 2) ** 2
        return [-size * mpmath.sin(middle), size * mpmath.cos(middle), z]

    weights = lag_coefficients(samples, previous)
    earlier = [mpmath.mpf(0)] * 3
    for lag, weight in enumerate(weights, start=1):
        row = increment(samples - lag)
        w = mpmath.mpf(weight.numerator) / weight.denominator
        earlier = [e + w * r for e, r in zip(earlier, row, strict=True)]
    total = [mpmath.fsum(increment(k)[i] for k in range(1, samples + 1)) for i in range(3)]
    a, b = earlier, increment(samples)
    phi = [
        total[0] + a[1] * b[2] - a[2] * b[1],
        total[1] + a[2] * b[0] - a[0] * b[2],
        total[2] + a[0] * b[1] - a[1] * b[0],
    ]
    angle = mpmath.sqrt(sum(p * p for p in phi))
    half = samples * turn / 2
    cosine = mpmath.cos(angle / 2) * mpmath.cos(half) - (
        phi[2] / angle * mpmath.sin(angle / 2) * mpmath.sin(half)
    )
    return -2 * (mpmath.acos(cosine) - half) / (samples * turn) / (theta**2 / 2)


@pytest.mark.parametrize("key", LEADING)
def test_order_and_size_of_the_drift(key):
    order, constant = LEADING[key]
    with mpmath.workdps(140):
        coarse, fine = (drift(*key, mpmath.mpf(turn)) for turn in ("0.02", "0.01"))
        slope = mpmath.log(coarse / fine) / mpmath.log(2)
        leading = mpmath.mpf(constant.numerator) / constant.denominator
        size = fine / (leading * mpmath.mpf("0.01") ** order)
    assert abs(slope - order) < 5e-4
    assert abs(size - 1) < 5e-4


def test_many_lags_are_still_exact():
    weights = lag_coefficients(1, 8)
    for k in range(3, 19, 2):
        terms = (x * (2 * m**k - (m + 1) ** k - (m - 1) ** k) for m, x in enumerate(weights, 1))
        assert sum(terms) == F(-1, 2)


def test_impossible_requests_are_refused():
    with pytest.raises(ValueError, match="0 samples"):
        lag_coefficients(0)
    with pytest.raises(ValueError, match="-1 previous"):
        lag_coefficients(2, -1)
    with pytest.raises(ValueError, match="singular"):
        solve([[F(1), F(2)], [F(2), F(4)]], [F(1), F(1)])
    # a zero on the diagonal needs another row first
    assert solve([[F(0), F(2)], [F(3), F(1)]], [F(4), F(5)]) == (F(1), F(2))


@pytest.mark.parametrize("name", ["optimal-7", "optimal-9", "previous-9", "optimal-3-previous-2"])
def test_names_of_any_size_have_these_coefficients(name):
    chosen = algorithm(name)
    digits = [int(part) for part in name.split("-")[1::2]]
    key = (1, digits[0]) if name.startswith("previous") else (digits[0], *digits[1:])
    weights = lag_coefficients(*key)
    assert chosen.name == name
    assert len(weights) == chosen.samples - 1 + chosen.before
    # unit increments in two axes give the weights back
    rows = chosen.before + chosen.samples
    for lag, weight in enumerate(weights, start=1):
        x = np.zeros((rows, 3))
        x[-1, 1] = x[-1 - lag, 0] = 1.0
        phi = chosen.rotation_vectors(x, np.full(rows, np.nan), chosen.before, 1)[0]
        assert phi[2] == pytest.approx(float(weight), rel=1e-14)


@pytest.mark.parametrize(("key", "order"), [((7, 0), 14), ((8, 0), 16), ((3, 2), 10), ((1, 6), 14)])
def test_order_beyond_the_published_ones(key, order):
    with mpmath.workdps(180):
        coarse, fine = (drift(*key, mpmath.mpf(turn)) for turn in ("0.02", "0.01"))
        slope = mpmath.log(coarse / fine) / mpmath.log(2)
    assert abs(slope - order) < 1e-3
