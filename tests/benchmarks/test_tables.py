"""The tables that the benchmarks print, against numbers that other code had arrived at.

`python benchmarks/coning_drift.py` and `python benchmarks/coning_tables.py TABLE` print them. An
entry is met to the last digit that it is given with, where a reference of 217 may be 217.53.
"""

import re
import subprocess
import sys
from decimal import Decimal

import numpy as np
import pytest

from benchmarks import coning_drift as drift
from benchmarks import coning_tables as tables
from sinstool.methods.coning.registry import FAMILIES, algorithm
from tests.helpers.paths import ROOT

DOCS = ROOT / "docs"


def assert_digits(value, text):
    unit = 10.0 ** int(Decimal(text).as_tuple().exponent)
    assert value == pytest.approx(float(text), rel=0, abs=0.55 * unit)


def assert_row(table, label, text):
    for value, entry in zip(table.rows[label], text.split(), strict=True):
        if entry != "*":
            assert_digits(value, entry)


SP = "singular-perturbation"

# 1 deg, 400 Hz, at 5, 10, 20, 30, 50, 75, 100 Hz; deg/h. An asterisk leaves an entry out: the
# reference has 2985, one number for optimal-2 and previous-1; its iteration of eight samples had
# not converged; and it has no number.
DRIFT = {
    "true coning rate": "987 1974 3948 5922 9869 1.48e4 1.97e4",
    "uncompensated": "1.014 8.107 64.6 216.7 984 3194 7172",
    "uncompensated, 100 Hz": "16.15 127.3 960 2934 9869 1.79e4 1.97e4",
    "optimal-2": "1.251e-3 3.99e-2 1.267 9.48 116 806 2985",
    "previous-1": "1.251e-3 3.99e-2 1.267 9.48 116 806 *",
    "optimal-3": "1.54e-6 2.10e-4 2.69e-2 .450 14.9 217 1314",
    "optimal-4": "9.7e-7 4.7e-5 3.7e-3 6.1e-2 2.67 63.8 812",
    "previous-3": "-1.4e-8 6.5e-7 5.6e-4 2.14e-2 1.92 59.6 590",
    "optimal-5": "4.5e-6 1.9e-4 1.2e-2 .128 1.92 20.7 271",
    "optimal-6": "1.3e-5 5.4e-4 3.0e-2 .293 2.45 5.2 128",
    "quatfiter-3": "-9.4e-4 -2.96e-2 -.903 -6.33 -61.6 -227 52",
    "picard-3": "-9.4e-4 -2.96e-2 -.903 -6.33 -61.6 -227 52",
    "quatfiter-4": "-4.9e-6 -6.2e-4 -7.7e-2 -1.23 -35.9 -403 -1537",
    "picard-4": "-4.9e-6 -6.2e-4 -7.7e-2 -1.23 -35.9 -403 -1537",
    "quatfiter-8": "0.0 -2e-7 -3.4e-4 -2.1e-2 -1.5 * *",
    "picard-8": "0.0 -2e-7 -3.4e-4 -2.1e-2 -1.5 * *",
}
DRIFT_RATES = {
    "rectangle rule": ".507 4.06 32.5 110 513 1753 4236",
    "rate x T, optimal-4": "-.507 -4.06 -32.6 -111 -521 -1766 -3932",
    f"{SP}, paper, printed": ".470 3.76 30.2 102 479 1654 4046",
    f"{SP}, paper, truncated": ".548 4.38 35.1 118 549 1860 4442",
    f"{SP}, paper, exact": ".548 4.38 35.1 118 549 1860 4442",
    f"{SP}, paper, bvp": ".548 4.38 35.1 118 549 1860 4442",
    f"{SP}, n = 1": "1.014 8.10 64.5 216 969 3096 6819",
    f"{SP}, epsilon = 0.032 s, printed": "-930 -7417 -5.9e4 -1.9e5 -8.3e5 * *",
    f"{SP}, epsilon = T/6, n = 2": "5.7e-4 1.83e-2 .585 4.42 55.9 410 1652",
    SP: "5.7e-4 1.83e-2 .585 4.42 55.9 410 1652",
}
# 0.1 deg at 30 Hz
NARROW = {
    "uncompensated": "2.167",
    "optimal-2": ".0948",
    "optimal-3": "4.44e-3",
    "optimal-4": "2.19e-4",
    "optimal-5": "2.3e-5",
    "optimal-6": "3.0e-5",
    "previous-3": "2.15e-4",
    "quatfiter-4": "-1.23e-2",
}
NARROW_RATES = {
    "rectangle rule": "1.100",
    "rate x T, optimal-4": "-1.108",
    f"{SP}, paper, printed": "1.02",
    f"{SP}, paper, truncated": "1.18",
    SP: "4.4e-2",
    "optimal-4, 4-point interpolation": "8.9e-2",
    "optimal-4": "4.2e-3",
    "optimal-4, 8-point interpolation": "4.1e-4",
}


@pytest.mark.parametrize(("kind", "rows"), [("mean-rate", DRIFT), ("rate", DRIFT_RATES)])
def test_drift(kind, rows):
    table = drift.drift_table(np.radians(1.0), 400.0, kind, drift.FREQUENCIES)
    for label, text in rows.items():
        assert_row(table, label, text)


@pytest.mark.parametrize(("kind", "rows"), [("increment", NARROW), ("rate", NARROW_RATES)])
def test_drift_of_a_narrow_cone(kind, rows):
    table = drift.drift_table(np.radians(0.1), 400.0, kind, (30.0,))
    for label, text in rows.items():
        assert_row(table, label, text)


@pytest.mark.slow
def test_manoeuvres():
    # The motions of the reference are not known: its numbers are a class, met within a factor of
    # four by the whole table (tests/methods/coning/test_manoeuvres.py), and an order of the rows.
    (table,) = tables.manoeuvres(motions=1, seconds=20.0)
    assert table.columns[0] == "slow at 100 Hz"
    for column in range(4):
        error = {label: values[column] for label, values in table.rows.items()}
        assert error["optimal-2"] < error["optimal-4"] < error["optimal-6"]
        assert error["quatfiter-4"] == pytest.approx(error["picard-4"], rel=1e-2)
        assert error["quatfiter-6"] < error["quatfiter-4"] < 0.1 * error["previous-3"] + 1e-4
        assert error[f"{SP} (best), rates"] < error[f"{SP} (paper), rates"]
        assert error["lookahead-12"] < 1e-7
        assert error["optimal-4, rate x T"] > 1e-3
    assert re.fullmatch(r"\d\.\de-\d\d", str(table).split("|")[-2].strip())


def test_single_line():
    parameters, missing = tables.single_line()
    assert_row(parameters, "for 30 Hz", ".08682 2.021")
    at = {column: i for i, column in enumerate(missing.columns)}
    for label, column, text in (
        (f"{SP} (best), rates", "30 Hz", "7.5e-4"),
        ("optimal-4, rate x T", "30 Hz", "-1.9e-2"),
        ("no compensation, rate x T", "30 Hz", "1.9e-2"),
        ("previous-1, mean rates", "30 Hz", "1.6e-3"),
        ("optimal-4, rates through 6 points", "30 Hz", "7.1e-5"),
        (f"{SP} (n for 30 Hz), rates", "20 Hz", "-2e-4"),
        (f"{SP} (n for 30 Hz), rates", "50 Hz", "3.7e-3"),
    ):
        assert_digits(missing.rows[label][at[column]], text)
    assert abs(missing.rows[f"{SP} (n for 30 Hz), rates"][at["30 Hz"]]) < 1e-9


# simulated and predicted, deg/h; the reference's phases were others, which makes 1.6 %
BROADBAND = {
    "uncompensated, mean rates": (0.0357, 0.0357),
    "uncompensated, mean rates, 100 Hz": (0.1529, 0.1514),
    "previous-1, mean rates": (0.0150, 0.0151),
    "optimal-2, mean rates": (0.0149, 0.0151),
    "no compensation, rate x T": (0.0215, 0.0215),
}


@pytest.mark.slow
def test_spectrum():
    parameters, drifts = tables.spectrum()
    for label, expected in BROADBAND.items():
        assert drifts.rows[label] == pytest.approx(expected, rel=0.02)
    folded, unfolded = drifts.rows["optimal-4, mean rates"]
    assert unfolded == pytest.approx(0.0051, abs=1.5e-4)
    assert folded - unfolded > 2e-4
    # the reference gained as much: 0.0081 to -0.0010, with an end effect of -0.0010 in both
    best, tuned = drifts.rows[f"{SP} (best), rates"], drifts.rows[f"{SP} (auto), rates"]
    np.testing.assert_allclose(np.subtract(best, tuned), 0.0091, atol=1.5e-4)
    assert parameters.rows["auto"][1] == pytest.approx(6 * parameters.rows["auto"][0] + 1.5)


# z error, deg, at 60, 100, 120, 150, 180, 199, 260 Hz
PSEUDO = {
    "optimal-4": "-.0086 -.0105 -.0113 -.0108 -.0081 -.0052 -.0051",
    "previous-1": "-.0082 -.0096 -.0098 -.0088 -.0068 -.0049 -.0049",
    "gyro-tuned, 12 lags, 60/110 Hz": "-.0033 -.0014 .00006 * * -.00001 *",
    "gyro-tuned, 16 lags, 60/100 Hz": "-.0033 -.0001 * * * * *",
    "gyro-tuned, 8 lags, 60 Hz": "-.0033 * * * * * *",
}
# where the reference's weights are others, within the 1.5e-5 deg that this makes
PSEUDO_CLOSE = {
    "gyro-tuned, 12 lags, 60/110 Hz": (0.00002, 0.00003, -0.00001, -0.000001),
    "gyro-tuned, 16 lags, 60/100 Hz": (0.000003, -0.000002, -0.00001, -0.000005),
}


@pytest.mark.slow
def test_pseudo_coning():
    increments, rates, answers, real, folding, above = tables.pseudo_coning()
    for label, text in PSEUDO.items():
        assert_row(increments, label, text)
    for label, expected in PSEUDO_CLOSE.items():
        np.testing.assert_allclose(increments.rows[label][3:], expected, rtol=0, atol=1.5e-5)
        assert np.abs(rates.rows[label][2:]).max() < 1e-4
    assert_digits(answers.rows["optimal-4"][0], "3.1e-2")
    assert_digits(answers.rows["gyro-tuned, 12 lags, 60/110 Hz"][1], "2e-4")
    # the caveat: worse than others where what is ignored is real
    worse = np.abs(real.rows["gyro-tuned, 12 lags, 60/110 Hz"])
    assert np.all(worse > np.abs(real.rows["optimal-4"]))
    # 120, 130, 220, 230 Hz
    assert_row(folding, "optimal-4", "* -.0215 * .0076")
    assert_row(folding, "previous-3", "* -.0063 * .0001")
    assert_row(folding, "optimal-4, rate x T", "* -.081 * *")
    for label, values in above.rows.items():
        if "point rates at 400 Hz" in label:
            assert_digits(values[0], ".557")
        else:
            assert_digits(values[0], "0.00000")
    assert_digits(above.rows["optimal-4, 2 kHz summed to 400 Hz"][1], "4e-5")
    assert_digits(above.rows["optimal-4, 2 kHz through a 150 Hz filter to 400 Hz"][1], "0.00000")


# 0.1 deg, 20 Hz at 200 Hz; 1 deg, 10 Hz at 100 Hz; 10 deg, 1 Hz at 100 Hz; deg/h
LOOK_AHEAD = {
    "uncompensated": "2.55 127 12.9",
    "previous-1": ".196 9.8 .0101",
    "optimal-2": ".196 9.8 .0099",
    "optimal-3": ".0161 .81 9e-5",
    "optimal-4": ".00138 .123 7.4e-4",
    "optimal-5": ".00015 .156 3.5e-3",
    "optimal-6": "6.8e-5 .288 9.8e-3",
    "picard-4": ".042 2.11 2.5e-5",
    "picard-8": "1.6e-3 .078 *",
    "lookahead-8": "1.19e-3 5.97e-2 *",
}
LOOK_AHEAD_RATES = {
    "previous-1, rate x T": "1.12 56 6.4",
    "trapezoid and 1/12 of the two rates' product": "2.52 126 12.9",
}


@pytest.mark.slow
def test_look_ahead():
    means, rates, noise = tables.look_ahead(runs=3)
    for label, text in LOOK_AHEAD.items():
        assert_row(means, label, text)
    for label, text in LOOK_AHEAD_RATES.items():
        assert_row(rates, label, text)
    # less than the reference's 2.8e-8 and 1.6e-6, whose series ended earlier
    assert means.rows["picard-8"][2] < 2.8e-8
    assert means.rows["lookahead-8"][2] < 1.6e-6
    assert np.all(np.array(means.rows["lookahead-12"]) < (1e-5, 5e-4, 2e-5))
    assert np.all(np.array(rates.rows["lookahead-12"]) < (7e-5, 7e-4, 1.6e-7))
    assert noise.rows["lookahead-12"][0] == pytest.approx(noise.rows["previous-1"][0], rel=0.01)


@pytest.mark.slow
def test_commands_print_their_tables():
    def printed(*command):
        done = subprocess.run(
            [sys.executable, *command], capture_output=True, text=True, cwd=ROOT, check=True
        )
        return done.stdout

    text = printed("benchmarks/coning_drift.py", "--frequencies", "10")
    assert "| uncompensated | 8.107 |" in text
    assert "| rectangle rule | 4.06 |" in text
    text = printed("-m", "benchmarks.coning_tables", "single-line")
    assert "| for 30 Hz | 0.08682 | 2.021 |" in text


def test_every_family_is_in_the_documentation():
    text = (DOCS / "coning.md").read_text()
    listed = set(re.findall(r"`([a-z0-9A-Z-]+)`", text))
    for family in FAMILIES:
        stem = re.sub(r"-\d+$", "", family.names[0])
        assert any(name == stem or re.sub(r"-[NP\d]+$", "", name) == stem for name in listed), stem


def test_the_example_of_a_new_algorithm_works():
    text = (DOCS / "adding-an-algorithm.md").read_text()
    code = re.search(r"```python\n(\"\"\"One update.*?)```", text, re.DOTALL)
    scope = {}
    exec(compile(code.group(1), "averaged.py", "exec"), scope)
    x = np.random.default_rng(1).normal(0.0, 0.01, (20, 3))
    dt = np.full(20, 0.01)
    np.testing.assert_allclose(
        scope["Averaged"]().rotation_vectors(x, dt, 0, 20),
        algorithm("previous-1").rotation_vectors(x, dt, 0, 20),
        rtol=1e-14,
    )
    assert scope["Averaged"]().shorter(1).samples == 1
