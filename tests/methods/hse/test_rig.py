import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.rig import EncoderModel, Rig, axis_to_matrix, from_table

IDEAL = axis_to_matrix(-np.ones(3) / np.sqrt(3.0))
K_G = [[1.001, 0.0, 0.0], [0.02, 0.998, 0.0], [-0.01, 0.03, 1.002]]
EXAMPLE = """
K_g = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
C_s_to_b = [[0.8165, -0.4082, -0.4082], [0.0, -0.7071, 0.7071], [-0.5774, -0.5774, -0.5774]]
gyro_frame = "g"
accel_frame = "s"
latitude_deg = 28.2
imu_stamp = "end"
[encoder]
joint = "table"
sign = 1
offset_rad = 0.0
delay_s = 0.0
"""


def test_ideal_axis_gives_the_printed_matrix():
    root3, root6 = np.sqrt(3.0), np.sqrt(6.0)
    printed = [
        [root6 / 3, 0.0, -root3 / 3],
        [-root6 / 6, -np.sqrt(2.0) / 2, -root3 / 3],
        [-root6 / 6, np.sqrt(2.0) / 2, -root3 / 3],
    ]  # C_b^s of the paper
    np.testing.assert_allclose(IDEAL.T, printed, atol=1e-15)


unit = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(
    lambda v: np.linalg.norm(v) > 0.1 and np.hypot(v[1], v[2]) > 0.02 * np.linalg.norm(v)
)


@given(unit)
def test_matrix_of_any_axis(v):
    e = np.array(v) / np.linalg.norm(v)
    C = axis_to_matrix(e)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(C) > 0.0
    np.testing.assert_allclose(C @ e, [0.0, 0.0, 1.0], atol=1e-13)
    x_gyro = C @ [1.0, 0.0, 0.0]
    assert abs(x_gyro[1]) < 1e-13  # x of b is where the x gyro points, along the axis
    assert x_gyro[0] > 0.0


def test_rounded_axis_is_a_direction_and_a_long_one_is_refused():
    np.testing.assert_allclose(axis_to_matrix([-0.5774, -0.5774, -0.5774]), IDEAL, atol=1e-15)
    with pytest.raises(ConfigurationError, match=r"rig\.e has length 1\.73"):
        axis_to_matrix([-1.0, -1.0, -1.0])
    with pytest.raises(ConfigurationError, match=r"rig\.e points along the x gyro"):
        axis_to_matrix([1.0, 0.0, 0.0])


def test_example_of_the_command_line():
    rig = from_table(tomllib.loads(EXAMPLE))
    assert rig.latitude == pytest.approx(np.radians(28.2))
    assert rig.encoder == EncoderModel(joint="table")
    # used as given: nothing is made orthonormal behind the user's back
    assert rig.C_s_to_b[2, 0] == -0.5774
    assert 1e-5 < rig.orthonormality_error < 3e-4
    (remark,) = rig.remarks()
    share = -3.0 * (0.5774 * np.sqrt(3.0) - 1.0)
    assert f"{np.degrees(share) * 3600:+.2f} arcsec" in remark
    assert not Rig(K_G, IDEAL).remarks()


def test_axis_in_place_of_the_matrix():
    table = tomllib.loads(EXAMPLE)
    del table["C_s_to_b"]
    table["e"] = [-0.5774, -0.5774, -0.5774]
    np.testing.assert_allclose(from_table(table).C_s_to_b, IDEAL, atol=1e-15)


def test_table_comes_back():
    encoder = EncoderModel("t", -1, 0.3, 2e-5, "deg", ((1, 1e-5, -2e-5), (3, 0.0, 4e-6)))
    rig = Rig(
        K_G, IDEAL, 1.01 * np.eye(3), [1e-6, 2e-6, -3e-6], [0.01, 0.02, 0.03], "g", "g", 1.0001,
        "mid", np.radians(-34.5), encoder,
    )  # fmt: skip
    again = from_table(rig.to_table())
    assert again.encoder == encoder
    assert again.to_table() == rig.to_table()
    assert again.sha256() == rig.sha256()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"K_g": np.transpose(K_G).tolist()}, r"rig\.K_g is not lower triangular"),
        ({"K_g": [[1, 0, 0], [0, 1, 0], [0, 0, 0.05]]}, r"rig\.K_g is nearly singular"),
        ({"K_g": [[1, 0], [0, 1]]}, r"rig\.K_g has shape \(2, 2\)"),
        ({"K_g": "one"}, r"rig\.K_g is not an array of numbers"),
        ({"K_g": [[10**400, 0, 0]] * 3}, r"rig\.K_g is not an array of numbers"),
        ({"latitude_deg": 10**400}, r"rig\.latitude_deg is 10{400}"),
        ({"C_s_to_b": (1.001 * IDEAL).tolist()}, r"rig\.C_s_to_b is not orthonormal"),
        ({"C_s_to_b": (1e308 * IDEAL).tolist()}, r"rig\.C_s_to_b is not orthonormal"),
        ({"C_s_to_b": (-IDEAL).tolist()}, r"rig\.C_s_to_b mirrors"),
        ({"C_s_to_b": [[float("nan")] * 3] * 3}, r"rig\.C_s_to_b .* not finite"),
        ({"e": [0, 0, 1]}, r"rig\.C_s_to_b and rig\.e are both given"),
        ({"K_a": [[1.1, 0, 0], [0, 1, 0], [0, 0, 1]]}, r"rig\.K_a is given, but"),
        ({"gyro_frame": "b"}, r"rig\.gyro_frame is 'b'"),
        ({"imu_stamp": "begin"}, r"rig\.imu_stamp is 'begin'"),
        ({"latitude_deg": 128.2}, r"rig\.latitude_deg is 128\.2"),
        ({"latitude_deg": "north"}, r"rig\.latitude_deg is 'north'"),
        ({"gyro_bias": [0, 0]}, r"rig\.gyro_bias has shape"),
        ({"gyro_scale": 0.0}, r"rig\.gyro_scale is 0"),
        ({"colour": 1}, r"rig\.colour is not known"),
        ({"encoder": 3}, r"rig\.encoder is 3"),
        ({"encoder": {"sing": 1}}, r"rig\.encoder\.sing is not known"),
        ({"encoder": {"sign": 2}}, r"rig\.encoder\.sign is 2"),
        ({"encoder": {"joint": 2}}, r"rig\.encoder\.joint is 2"),
        ({"encoder": {"unit": "gon"}}, r"rig\.encoder\.unit is 'gon'"),
        ({"encoder": {"delay_s": 20.0}}, r"rig\.encoder\.delay_s is 20 s"),
        ({"encoder": {"offset_rad": True}}, r"rig\.encoder\.offset_rad is True"),
        ({"encoder": {"harmonics": [[1, 2]]}}, r"rig\.encoder\.harmonics\[0\]"),
        ({"encoder": {"harmonics": [[0, 1, 2]]}}, r"harmonics\[0\] has order 0"),
        ({"encoder": {"harmonics": 7}}, r"rig\.encoder\.harmonics is 7"),
    ],
)
def test_what_is_wrong_is_named_by_its_key(change, words):
    with pytest.raises(ConfigurationError, match=words):
        from_table(tomllib.loads(EXAMPLE) | change)


def test_missing_keys():
    table = tomllib.loads(EXAMPLE)
    without = {key: value for key, value in table.items() if key != "K_g"}
    with pytest.raises(ConfigurationError, match=r"rig\.K_g is missing"):
        from_table(without)
    assert from_table(without | {"gyro_frame": "s"}).gyro_frame == "s"
    del table["C_s_to_b"]
    with pytest.raises(ConfigurationError, match="both missing"):
        from_table(table)
    with pytest.raises(ConfigurationError, match=r"rig\.latitude_deg is missing"):
        Rig(K_G, IDEAL).require_latitude()


def test_fingerprint_is_of_what_lambda2_depends_on():
    rig = Rig(K_G, IDEAL, latitude=0.49)
    same = [
        replace(rig, latitude=-0.3),
        replace(rig, gyro_bias=np.array([1e-6, 0.0, 0.0])),
        replace(rig, accel_bias=np.array([1e-3, 0.0, 0.0])),
        replace(rig, encoder=EncoderModel(joint="t", offset=0.4, unit="deg")),
        replace(rig, C_s_to_b=np.where(rig.C_s_to_b == 0.0, -0.0, rig.C_s_to_b)),
        replace(rig, K_g=np.where(rig.K_g == 0.0, -0.0, rig.K_g)),
    ]
    assert {r.sha256() for r in same} == {rig.sha256()}
    nudged = np.array(K_G)
    nudged[2, 0] += 1e-9
    others = [
        replace(rig, K_g=nudged),
        replace(rig, C_s_to_b=axis_to_matrix([-0.6, -0.48, -0.64])),
        replace(rig, gyro_frame="s"),
        replace(rig, gyro_scale=1.0 + 1e-9),
        replace(rig, imu_stamp="mid"),
        replace(rig, encoder=EncoderModel(sign=-1)),
        replace(rig, encoder=EncoderModel(delay=1e-6)),
        replace(rig, encoder=EncoderModel(harmonics=((1, 1e-6, 0.0),))),
    ]
    assert len({r.sha256() for r in [rig, *others]}) == len(others) + 1


def test_scaled_acts_in_either_frame_of_the_gyros():
    rig = Rig(K_G, IDEAL)
    for frame in ("g", "s"):
        before = replace(rig, gyro_frame=frame)
        after = before.scaled(2e-5)
        np.testing.assert_allclose(after.gyro_to_b, (1.0 - 2e-5) * before.gyro_to_b, rtol=1e-15)
        np.testing.assert_array_equal(after.accel_to_b, before.accel_to_b)
        assert after.sha256() != before.sha256()


def test_matrices_by_frame():
    K_a = [[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.02, 1.0]]
    raw = Rig(K_G, IDEAL, K_a, accel_frame="g")
    np.testing.assert_allclose(raw.gyro_to_b, IDEAL @ K_G, rtol=1e-15)
    np.testing.assert_allclose(raw.accel_to_b, IDEAL @ K_a, rtol=1e-15)
    done = Rig(K_G, IDEAL, gyro_frame="s")
    np.testing.assert_array_equal(done.gyro_to_b, IDEAL)
    with pytest.raises(ValueError, match="read-only"):
        raw.K_g[0, 0] = 2.0
