import json
import types
import typing
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.calibration import HseCalibration, RunRecord, from_fit, require_config
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import METHODS, FitOptions
from sinstool.methods.hse.status import STATUSES, judge
from sinstool.pipelines.calibrate_hse.calibration_file import dumps, from_dict, loads, to_dict
from tests.methods.hse.made_runs import ARCSEC, EPSILON, RATES, brute_runs, noisy

SHA = "0123456789abcdef" * 4


def made(options=None, **more):
    runs = brute_runs(**more)
    if options is None:
        runs += brute_runs(psi=0.7 + np.pi, lean=-8e-4, first=9, **more)
    result = fit(noisy(runs, np.random.default_rng(2)), options)
    return from_fit(result, judge(result), "2026-01-02T03:04:05Z", "sinstool 0.1.0", SHA)


def values(kind):
    """Any value of a field's type."""
    if is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return st.builds(kind, **{f.name: values(hints[f.name]) for f in fields(kind)})
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is types.UnionType:
        return st.none() | values(inner[0])
    if origin is tuple:
        if inner[-1] is ...:
            return st.lists(values(inner[0]), max_size=3).map(tuple)
        return st.tuples(*(values(one) for one in inner))
    simple = {
        float: st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6),
        int: st.integers(0, 10**6),
        str: st.text(max_size=20),
        bool: st.booleans(),
    }
    return simple[kind]


@st.composite
def calibrations(draw):
    cal = draw(values(HseCalibration))
    n = draw(st.integers(0, 3))
    number = values(float)
    positive = st.none() | st.floats(0.0, 1e3)
    used = replace(draw(values(RunRecord)), used=True)
    return replace(
        cal,
        method=draw(st.sampled_from(METHODS)),
        status=draw(st.sampled_from(STATUSES)),
        parameters=tuple(f"p{i}" for i in range(n)),
        cov=tuple(tuple(draw(number) for _ in range(n)) for _ in range(n)),
        sigma_lambda2_rad=draw(positive),
        sigma_K_HSE_s=draw(positive),
        sigma_delay_s=draw(positive),
        sigma_C23_rad=draw(st.floats(0.0, 1.0)),
        latitude_rad=draw(st.floats(-1.5, 1.5)),
        omega_ie=EARTH_RATE,
        runs=(*cal.runs, used),
        config_sha256=draw(st.text("0123456789abcdef", min_size=64, max_size=64)),
    )


@pytest.mark.slow
@settings(max_examples=60)
@given(calibrations())
def test_text_gives_back_every_bit(cal):
    assert loads(dumps(cal)) == cal
    assert from_dict(to_dict(cal)) == cal


def test_the_schema():
    cal = made()
    data = json.loads(dumps(cal))
    keys = """schema created tool method status warnings sign lambda2_rad lambda2_arcsec
        sigma_lambda2_rad ci95_lambda2_rad eps_sum_rad K_HSE_s K_HSE_arcsec_per_rad_s psi0_rad
        cov C23_rad sigma_C23_rad C23_spread axial delay_s latitude_rad omega_ie fit runs
        config_sha256"""
    assert set(keys.split()) <= data.keys()
    assert data["schema"] == "sinstool.hse/1"
    assert data["sign"]["apply"] == "psi=psi_hat-dpsi"
    assert {"c", "lambda2_rad", "sigma_rad", "z_consistency"} <= data["axial"].keys()
    keys = "n_runs n_rates dof chi2 s_rad r2 F_lof p_lof cond rates_rad_s"
    assert set(keys.split()) <= data["fit"].keys()
    keys = """source t_start_s duration_s n_turns rate_rad_s psi_rad sigma_psi_rad theta gamma C23
        c_axial resid_rad used reason"""
    assert set(keys.split()) <= data["runs"][0].keys()
    assert data["lambda2_arcsec"] == pytest.approx(data["lambda2_rad"] / ARCSEC)
    assert data["eps_sum_rad"] == -data["lambda2_rad"]
    assert data["K_HSE_arcsec_per_rad_s"] == pytest.approx(data["K_HSE_s"] / ARCSEC)
    assert data["method"] == "joint" and data["fit"]["n_runs"] == 18
    assert data["axial"]["lambda2_rad"] == pytest.approx(-EPSILON.sum(), rel=0.02)
    assert len(data["cov"]) == len(data["parameters"]) == 4


def test_what_is_not_known_is_null():
    level = made(FitOptions(method="heading"), lean=2e-5)
    data = json.loads(dumps(level))
    assert (data["status"], data["lambda2_rad"], data["lambda2_arcsec"]) == ("unobservable",) + (
        None,
    ) * 2
    assert data["K_HSE_s"] is not None and data["axial"]["lambda2_rad"] is not None
    assert loads(dumps(level)) == level
    lone = fit([replace(r, sigma_heading=np.nan) for r in brute_runs(rates=RATES[[0, 2]])])
    calibration = from_fit(lone, judge(lone), "t", "v", SHA)
    assert calibration.cov == () and calibration.runs[0].sigma_psi_rad is None
    assert loads(dumps(calibration)) == calibration
    one = fit(brute_runs(rates=RATES[[1]]))
    calibration = from_fit(one, judge(one), "t", "v", SHA)
    assert (calibration.status, calibration.lambda2_rad, calibration.K_HSE_s) == (
        "error",
        None,
        None,
    )
    assert loads(dumps(calibration)) == calibration


def test_ranges_are_of_the_runs_in_use():
    cal = made(FitOptions(method="heading", exclude=("r2", "r5", "r8")))
    assert cal.rate_range == pytest.approx((RATES[0], RATES[1]))
    assert cal.max_C23 == pytest.approx(8e-4, rel=1e-3)


def paths(data, at=()):
    """Every key of a nested table, lists by their first item."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield (*at, key)
            yield from paths(value, (*at, key))
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        yield from paths(data[0], (*at, 0))


def changed(data, path, value=None, remove=False):
    data = json.loads(json.dumps(data))
    place = data
    for key in path[:-1]:
        place = place[key]
    if remove:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return data


def test_every_key_is_needed_and_has_its_type():
    data = to_dict(made())
    every = list(paths(json.loads(dumps(made()))))
    assert len(every) > 60
    for path in every:
        with pytest.raises(ConfigurationError):
            from_dict(changed(data, path, remove=True))
        with pytest.raises(ConfigurationError):
            from_dict(changed(data, path, {"wrong": 1}))
        with pytest.raises(ConfigurationError):
            from_dict(changed(data, (*path[:-1], "unknown"), 1))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("schema",), "sinstool.hse/2", "'sinstool.hse/2', this program reads 'sinstool.hse/1'"),
        (("sign", "apply"), "psi=psi_hat+dpsi", "sign convention"),
        (("lambda2_arcsec",), 4.2, "contradicts"),
        (("lambda2_arcsec",), 10**400, "contradicts"),
        (("eps_sum_rad",), 2e-5, "contradicts"),
        (("K_HSE_arcsec_per_rad_s",), None, "contradicts"),
        (("fit", "dof"), 7.5, "fit.dof is 7.5: it should be a valid int"),
        (("fit", "dof"), True, "fit.dof"),
        (("axial", "c"), "1e-5", "axial.c"),
        (("axial", "c"), None, "axial.c"),
        (("axial", "c"), True, "axial.c"),
        (("runs", 0, "used"), 1, "runs.0.used is 1: it should be a valid bool"),
        (("ci95_lambda2_rad",), [1e-5], "lacks ci95_lambda2_rad.1"),
        (("warnings",), "none", "warnings"),
        (("status",), "fine", "status is impossible"),
        (("method",), "guess", "method is impossible"),
        (("sigma_lambda2_rad",), -1e-6, "standard deviations"),
        (("cov",), [[1.0]], "cov is impossible"),
        (("latitude_rad",), 28.2, "latitude_rad is impossible"),
        (("latitude_rad",), -1.58, "latitude_rad is impossible"),
        (("omega_ie",), 7.3e-5, "omega_ie is impossible"),
        (("config_sha256",), "abc", "config_sha256 is impossible"),
        (("runs",), [], "runs is impossible"),
    ],
)
def test_what_is_wrong_is_named(path, value, words):
    with pytest.raises(ConfigurationError, match=words) as caught:
        from_dict(changed(to_dict(made()), path, value))
    assert caught.value.hint


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": NaN}', "null", "{"])
def test_other_texts_are_refused(text):
    with pytest.raises(ConfigurationError, match="no calibration of heading-sensitive error"):
        loads(text)


def test_infinite_numbers_are_refused():
    text = dumps(made()).replace('"C23_spread": ', '"C23_spread": 1e999, "x": ')
    with pytest.raises(ConfigurationError):
        loads(text)


def test_another_rig_is_refused_unless_forced():
    cal = made()
    assert require_config(cal, SHA) is None
    other = "f" * 64
    with pytest.raises(ConfigurationError, match="another configuration") as caught:
        require_config(cal, other)
    assert "--force" in caught.value.hint
    assert caught.value.exit_code == 2
    assert "another configuration" in require_config(cal, other, force=True)
