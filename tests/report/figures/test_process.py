"""Figures of a run, drawn from columns made by hand: their numbers and units."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.report.figures import process as draw

ARCSEC = np.pi / 180.0 / 3600.0
AXES = ("north", "east", "down")


def curves(seconds=(0.0, 1.0, 2.0), **columns):
    of = {name.replace("_", " "): np.asarray(values, float) for name, values in columns.items()}
    return draw.Curves(np.asarray(seconds, float), of)


def sigmas(kind, *values):
    return {f"{kind}_{axis}": np.full(3, value) for axis, value in zip(AXES, values, strict=True)}


def drawn(figure):
    return {one.name: one for one in figure.series}


def test_small_errors_of_attitude_are_in_arcsec_and_so_are_their_bounds():
    seconds = np.array([0.0, 0.5, 1.5, 2.0])
    error = np.outer([1.0, 2.0, np.nan, -3.0], [10.0, 20.0, -100.0]) * ARCSEC
    # one arc second, two, and a thousandth of a degree, 3.6 arc seconds
    columns = curves(**sigmas("attitude", 1 / 3600.0, 2 / 3600.0, 1e-3))
    (figure,) = draw.errors({"attitude": (seconds, error)}, columns)
    assert (figure.key, figure.ylabel) == ("error-attitude", "error, arcsec")
    np.testing.assert_array_equal(figure.x, seconds)
    shown = drawn(figure)
    assert list(shown) == [*AXES, *(f"3 sigma, {axis}" for axis in AXES)]
    np.testing.assert_allclose(shown["east"].y, [20.0, 40.0, np.nan, -60.0])
    np.testing.assert_allclose(shown["down"].y, [-100.0, -200.0, np.nan, 300.0])
    for axis, bound in zip(AXES, (3.0, 6.0, 10.8), strict=True):
        one = shown[f"3 sigma, {axis}"]
        np.testing.assert_allclose(one.y, [bound] * 3 + [np.nan] + [-bound] * 3)
        np.testing.assert_allclose(one.x, [0.0, 1.0, 2.0, 2.0, 0.0, 1.0, 2.0])
        assert (one.style, one.colour) == ("dashed", AXES.index(axis))
    assert len(figure.notes) == 2 and "three" in figure.notes[1]


@pytest.mark.parametrize("largest, unit, shown", [(0.0999, "arcsec", 359.64), (0.11, "deg", 0.11)])
def test_unit_of_attitude_is_settled_by_the_largest_error(largest, unit, shown):
    error = np.radians([[0.01, 0.02, -largest]])
    columns = curves(**sigmas("attitude", 0.5, 0.5, 0.5))
    (figure,) = draw.errors({"attitude": (np.zeros(1), error)}, columns)
    assert figure.ylabel == f"error, {unit}"
    np.testing.assert_allclose(drawn(figure)["down"].y, [-shown])
    bound = 1.5 * (3600.0 if unit == "arcsec" else 1.0)
    np.testing.assert_allclose(drawn(figure)["3 sigma, north"].y[:3], bound)


@pytest.mark.parametrize("largest, unit, size", [(4999.0, "m", 1.0), (7200.0, "km", 1000.0)])
def test_large_errors_of_position_are_in_km_and_so_are_their_bounds(largest, unit, size):
    seconds, error = np.array([0.0, 4.0]), np.array([[1.0, -2.0, 3.0], [-largest, 0.0, 50.0]])
    columns = curves(**sigmas("position", 100.0, 200.0, 300.0))
    (figure,) = draw.errors({"position": (seconds, error)}, columns)
    assert figure.ylabel == f"error, {unit}"
    shown = drawn(figure)
    np.testing.assert_allclose(shown["north"].y, np.array([1.0, -largest]) / size)
    np.testing.assert_allclose(shown["3 sigma, down"].y[:3], 900.0 / size)
    np.testing.assert_allclose(shown["3 sigma, down"].y[4:], -900.0 / size)


def test_errors_without_sigmas_have_no_bounds_and_none_at_all_no_figure():
    off = {
        "velocity": (np.arange(2.0), np.array([[0.5, -0.25, 9000.0], [1.0, 2.0, 3.0]])),
        "position": (np.arange(2.0), np.full((2, 3), np.nan)),
    }
    (figure,) = draw.errors(off, curves(heading=np.zeros(3)))
    assert (figure.key, figure.ylabel) == ("error-velocity", "error, m/s")
    assert list(drawn(figure)) == list(AXES)
    np.testing.assert_array_equal(drawn(figure)["down"].y, [9000.0, 3.0])


def test_sigmas_are_drawn_where_there_are_no_errors():
    columns = curves(**sigmas("position", 1.0, 2.0, 3.0), **sigmas("attitude", 0.1, 0.2, 0.3))
    by_name = draw.sigmas(columns, without=("position",))
    assert [(one.key, one.ylabel) for one in by_name] == [("sigma-attitude", "sigma, deg")]
    np.testing.assert_array_equal(drawn(by_name[0])["down"].y, [0.3] * 3)


def test_height_its_difference_and_what_held_it():
    columns = curves(height=[100.0, 101.0, 103.0], up=[1.0, 1.5, 2.0], correction=[0.0, 1e-3, 2e-3])
    at, values = np.array([0.5, 1.5]), np.array([[99.0, 1.5], [100.0, 2.0]])
    marks = (("coast", 1.25),)
    by_name = {one.key: one for one in draw.vertical(columns, ("/baro", at, values), marks)}
    assert {key: one.ylabel for key, one in by_name.items()} == {
        "height": "height, m",
        "difference": "difference, m",
        "up": "velocity up, m/s",
        "correction": "correction, m/s²",
    }
    assert all(one.marks == marks for one in by_name.values())
    np.testing.assert_array_equal(drawn(by_name["height"])["computed"].y, [100.0, 101.0, 103.0])
    reference = drawn(by_name["height"])["/baro"]
    np.testing.assert_array_equal(reference.x, at)
    np.testing.assert_array_equal(reference.y, [99.0, 100.0])
    np.testing.assert_array_equal(by_name["difference"].x, at)
    np.testing.assert_array_equal(
        drawn(by_name["difference"])["computed less reference"].y, [1.5, 2]
    )
    assert by_name["difference"].title == "Difference from the height of /baro"
    np.testing.assert_array_equal(drawn(by_name["up"])["up"].y, [1.0, 1.5, 2.0])
    assert draw.vertical(curves(up=np.zeros(3)), None, ()) == []


def test_roll_and_pitch_share_an_axis_unless_they_are_far_apart():
    level = draw.tilt(curves(roll=[0.0, 1.0, 2.0], pitch=[3.0, 4.0, 5.0]), "note")
    assert [one.key for one in level] == ["tilt"]
    odd = draw.tilt(curves(roll=[165.0, 166.0, 167.0], pitch=[-61.0, -60.0, -59.0]), "note")
    assert [(one.key, one.title, one.ylabel) for one in odd] == [
        ("roll", "Roll", "roll, deg"),
        ("pitch", "Pitch", "pitch, deg"),
    ]
    np.testing.assert_array_equal(drawn(odd[1])["pitch"].y, [-61.0, -60.0, -59.0])
    # A flight that rolls over is not far from its pitch
    assert len(draw.tilt(curves(roll=[-170.0, 20.0, 170.0], pitch=[0.0, 1.0, 2.0]), "")) == 1


def test_heading_has_holes_where_it_goes_over_the_turn():
    figure = draw.heading(
        curves(np.arange(6.0), heading=[250, 350, 450, 550, 650, 710]), "Of the IMU."
    )
    np.testing.assert_allclose(figure.x, [0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 5.0])
    np.testing.assert_allclose(
        drawn(figure)["heading"].y, [250.0, 350.0, np.nan, 90.0, 190.0, 290.0, 350.0]
    )


def test_the_note_of_the_heading_says_from_where_it_counts():
    columns = curves(np.arange(2.0), heading=[1.0, 2.0])
    assert (
        "from magnetic north. Of the IMU."
        in draw.heading(columns, "Of the IMU.", "magnetic north").notes[0]
    )
    assert "Nothing in the log shows north" in draw.heading(columns, "", "").notes[0]


def test_stretches_are_about_the_median_also_over_the_end_of_the_turn():
    def stretch(rate, raw, corrected):
        return SimpleNamespace(
            rate_deg_s=rate, heading_raw_deg=raw, heading_deg=corrected, sigma_heading_arcsec=None
        )

    stretches = [
        stretch(-60.0, 0.002, 359.999),
        stretch(60.0, 359.997, 359.999),
        stretch(100.0, 0.0, 0.0),
    ]
    figure = draw.stretches(SimpleNamespace(segments=stretches))
    assert (figure.xlabel, figure.ylabel) == ("rate, deg/s", "heading, arcsec")
    np.testing.assert_array_equal(figure.x, [-60.0, 60.0, 100.0])
    shown = drawn(figure)
    np.testing.assert_allclose(shown["as aligned"].y, [10.8, -7.2, 3.6], atol=1e-6)
    np.testing.assert_allclose(shown["corrected"].y, [0.0, 0.0, 3.6], atol=1e-6)
