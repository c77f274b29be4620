"""Configuration files, options, and how they fit together."""

import json
import tomllib

import click
import pytest

from sinstool.cli.main import cli
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from tests.helpers.one_line import one_line, usage
from tests.helpers.paths import ROOT

WRONG = {
    "[inputt]": "unknown key inputt",
    "[input]\nbody_axis = 'flu'": "unknown key input.body_axis",
    "loud = true": "unknown key loud",
    "input = 3": "input = 3: must be a table",
    "[input]\nbody_axes = 'FLU'": "input.body_axes = 'FLU': must be 'flu' or 'frd'",
    "[input]\nimu_topic = 5": "input.imu_topic = 5: must be a valid string",
    "[input]\nsalvage = 'yes'": "input.salvage = 'yes': must be a valid boolean",
    "[input]\nsalvage = 1": "input.salvage = 1: must be a valid boolean",
    "[input]\nimu_rate = 0": "input.imu_rate = 0: ",
    "[input]\nimu_rate = inf": "input.imu_rate = inf: must be a finite number",
    "[input]\nimu_rate = '200'": "input.imu_rate = '200': must be a valid number",
    "[input]\nmax_gap = -1.0": "input.max_gap = -1.0: must be greater than 0",
    "[input]\nstart = 'noon'": "input.start = 'noon': 'noon' is not a time",
    "[input]\nend = true": "input.end = true: ",
    "[input]\nend = '1e400'": "input.end = '1e400': ",
    "[coning]\nconing = 'optimal-x'": "coning.coning = 'optimal-x': unknown coning algorithm",
    "[coning]\nepsilon = -1e-3": "coning.epsilon = -0.001: ",
    "[align]\nlatitude = 91": "align.latitude = 91: must be less than or equal to 90",
    "[align]\nlatitude = nan": "align.latitude = nan: ",
    "[align]\nlatitude = true": "align.latitude = true: must be a valid number",
    "[align]\ngyro_bias = [1, 2]": "align.gyro_bias = [1, 2]: too few values",
    "[align]\ngyro_bias = [1, 2, 'x']": "align.gyro_bias[2] = 'x': must be a valid number",
    "[align]\ngyro_bias = 'rest'": "align.gyro_bias = 'rest': must be 'still' or 'none'",
    "[align]\ninitial_attitude = [1, 2, 3, 4]": "align.initial_attitude = [1, 2, 3, 4]: too many",
    "[output]\nemit = ['imu', 'odometer']": "'odometer' is not one of",
    "[output]\nemit = ['imu', 'odometry']": "--emit odometry: this run does not compute it",
    "[output]\nemit = []": "output.emit = []: nothing is left",
    "[output]\nemit = 'imu'": "output.emit = 'imu': must be a list",
    "[output": "not valid TOML",
    "[align]\nalign = 'fixed'": "--align fixed needs an attitude",
    "[align]\ninitial_attitude = [1, 2, 3]": "--initial-attitude is given",
    "[coning]\nbeta_gain = 2.0": "--beta-gain has no effect with --coning previous-3",
    "[coning]\nconing = 'gyro-tuned'\nepsilon = 1.0": "--epsilon has no effect with",
    "[coning]\nconing = 'singular-perturbation'\npassband = 9.0": "--passband has no effect with",
    "[input]\nstart = '1e9999999'": "input.start = '1e9999999': '1e9999999' is a time that no log",
    "[input]\ngnss_clock_offset = 1e300": "input.gnss_clock_offset = 1e+300: must be less than",
}


@pytest.mark.parametrize("toml", WRONG)
def test_wrong_configuration(sinstool, log, tmp_path, toml):
    path = tmp_path / "run.toml"
    path.write_text(toml)
    status, out, err = sinstool("process", log, "-o", tmp_path / "o.mcap", "--config", path)
    assert status == 2 and out == ""
    line = one_line(err)
    assert WRONG[toml] in line
    if not WRONG[toml].startswith("--"):
        assert f"{path}: " in line
    assert not (tmp_path / "o.mcap").exists()


def test_a_configuration_that_is_not_there(sinstool, tmp_path):
    status, _, err = sinstool("process", "--config", tmp_path / "no.toml", "--print-config")
    assert status == 2 and "no.toml: cannot be read" in one_line(err)
    (tmp_path / "latin.toml").write_bytes(b'[input]\nimu_topic = "\xe4"')
    status, _, err = sinstool("process", "--config", tmp_path / "latin.toml", "--print-config")
    assert status == 2 and "it is not text" in one_line(err)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--latitude", "99"), "--latitude 99.0: must be less than or equal to 90"),
        (("--gyro-bias", "1,2,nan"), "--gyro-bias nan: must be a finite number"),
        (("--emit", "foo"), "--emit foo: 'foo' is not one of"),
        (("--coning", "optimal-x"), "--coning 'optimal-x': unknown coning algorithm"),
        (("--imu-rate", "0"), "--imu-rate 0.0: "),
        (("--start", "soon"), "--start 'soon': 'soon' is not a time"),
        (("--align", "fixed"), "give --initial-attitude"),
        (("--sp-preset", "paper"), "choose --coning singular-perturbation"),
        (("--window", "1e308"), "--window 1e+308: must be less than or equal to 1000000000"),
        (("--align-end", "1e308"), "--align-end 1e+308: must be less than or equal to 1000000000"),
        (("--lift-off", "-1e308"), "--lift-off -1e+308: must be greater than or equal to"),
        (("--lever-arm", "0,1e308,0"), "--lever-arm 1e+308: must be less than or equal to 1000000"),
        (("--gnss-sigma-v", "1e308"), "--gnss-sigma-v 1e+308: must be less than or equal to"),
    ],
)
def test_wrong_options_are_named(sinstool, log, tmp_path, options, expected):
    status, _, err = sinstool("process", log, "-o", tmp_path / "o.mcap", *options)
    assert status == 2 and expected in one_line(err)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("process",), "give a LOG"),
        (("process", "a.mcap"), "-o FILE"),
        (("proces",), "did you mean process?"),
        (("dance",), "there are info, process, export, align, allan, compare-coning"),
        (("process", "a", "-o", "b", "--imu-tpic", "x"), "--imu-topic"),
        (("process", "a", "-o", "b", "--align", "sideways"), "'sideways' is not one of"),
        (("process", "a", "-o", "b", "--gyro-bias", "1,2"), "'1,2' is not 3 numbers"),
        (("process", "a", "-o", "b", "--latitude", "north"), "'north' is not a valid float"),
        (("info",), "LOG"),
        (("simulate", "dance", "-o", "x"), "there is no scenario 'dance': there are"),
    ],
)
def test_usage(sinstool, arguments, expected):
    status, out, err = sinstool(*arguments)
    assert status == 2 and out == "" and expected in usage(err)
    status, out, err = sinstool(*arguments, "--json")
    assert status == 2 and json.loads(out)["exit"] == 2 and json.loads(out)["error"] in err


FULL = """
[input]
imu_topic = "/imu"
gnss_topic = "/fix"
velocity_topic = "/velocity"
wheels = "/wheels"
baro_topic = "/baro"
baro_kind = "height"
baro_unit = "hPa"
gnss_unit = "rad"
encoder_topic = "/joints"
start = 1.5
end = 2023-11-14T22:13:25Z
body_axes = "frd"
gyro_kind = "mean-rate"
gyro_unit = "deg/s"
accel_unit = "g"
imu_rate = 200
max_gap = 0.25
salvage = true

[coning]
coning = "singular-perturbation"
sp_variant = "bvp"
epsilon = 1e-3
beta = [1, 2.5, -3]

[align]
align = "fixed"
initial_attitude = [1, 2, 3]
gyro_bias = [0.1, 0, -1e-5]
latitude = -33.5
longitude = 151
height = 12.5

[gnss]
lever_arm = [1, -0.5, 0.25]
gnss_latency = -0.125
gnss_sigma_v = 0.2

[in_flight]
vectors = "cen"
window = 3
fade = 60
gate = "mask"
refine = "none"
align_start = 1.5
align_end = 100
lift_off = 3
f_set = 13
df_set = 90
w_set = 6
dw_set = 80
t_set1 = 30
n_set1 = 2
t_set2 = 100
n_set2 = 150
gate_smooth = 5
sigma_stop = 0.5
sigma_bg = 3
sigma_ba = 0.02
sigma_sf = 3e-4
bias_time = 500
arw = 0.1
vrw = 70
kappa = 1
gyro_range = 300
accel_range = 200

[navigation]
magnetometer = "/mag"
declination = -3.5
mode = "auto"
initial_velocity = [1, 2, -3]
imu_grade = "tactical"
attitude_order = "4"

[filter]
filter = "baro-24"
feedback = "none"
virtual_noise = "off"
adaptive = "innovation"
schmidt_epsilon = 0.05
restart_after = 30
gnss_lasting = 0.5
smooth = true
withhold_gnss = ["10:20", "30:40.5"]
gnss_sigma = 3
gnss_noise_scale = 2
baro_sigma = 4
gnss_velocity_lag = 0.125
sigma_misalignment = 0.2

[vertical]
height_damping = "baro"
height_preset = "paper"
tau = 2.5
k4 = -0.25
baro_lag = 0.5
baro_ref = "init"
qnh = 101000
undulation = 40.5

[hse]
hse = "calibration.json"
force = true

[rig]
e = [-0.577350269189626, -0.577350269189626, -0.577350269189626]
K_g = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
latitude_deg = 28.2
encoder = { joint = "table" }

[output]
world = "ned"
emit = ["euler", "imu", "euler"]
only_results = true
compression = "lz4"
overwrite = true
report = "page.html"
truth = ["/truth/imu", "attitude.csv"]
"""


def test_the_printed_configuration_can_be_fed_back(sinstool, tmp_path):
    (tmp_path / "full.toml").write_text(FULL)
    status, first, err = sinstool("process", "--config", tmp_path / "full.toml", "--print-config")
    assert (status, err) == (0, "")
    (tmp_path / "back.toml").write_text(first)
    _, second, _ = sinstool("process", "--config", tmp_path / "back.toml", "--print-config")
    assert second == first
    got = tomllib.loads(first)
    assert got["input"]["start"] == "1.5"
    assert got["input"]["end"] == "2023-11-14T22:13:25+00:00"
    assert got["coning"]["beta"] == [1.0, 2.5, -3.0]
    assert got["output"]["emit"] == ["euler", "imu"]
    # every key that can be said with another is said here
    said = {(g, k) for g, keys in got.items() for k in keys}
    assert {(g, k) for g, k in fields()} - said == {
        ("coning", "sp_preset"),
        ("coning", "beta_gain"),
        # of other algorithms than the one in FULL
        ("coning", "passband"),
        ("coning", "stopband"),
        ("coning", "gyro_response"),
        # in place of the grade that is in FULL
        ("navigation", "imu_noise"),
        # nothing is mounted in a vehicle that may do anything
        ("filter", "mount"),
    }


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--mode", "attitude", "--smooth"), "--smooth has no effect with --mode attitude: "),
        (("--mode", "ins", "--withhold-gnss", "1:2", "--smooth"), "--smooth and --withhold-gnss"),
        (("--mode", "ins-gnss", "--declination", "2"), "choose --mode attitude"),
        (("--mode", "attitude", "--initial-velocity", "1,2,3"), "choose --mode ins"),
        (("--mode", "attitude", "--vehicle", "land"), "choose --mode ins-gnss"),
    ],
)
def test_options_without_effect_are_refused(sinstool, log, tmp_path, options, expected):
    status, _, err = sinstool("process", log, "-o", tmp_path / "o.mcap", *options)
    assert status == 2 and expected in one_line(err)
    assert not (tmp_path / "o.mcap").exists()


def test_options_that_the_chosen_mode_does_not_use_are_reported(sinstool, log, tmp_path):
    options = ("--smooth", "--vehicle", "none", "--magnetometer", "none", "--json")
    status, out, err = sinstool("process", log, "-o", tmp_path / "o.mcap", *options)
    assert status == 0
    (finding,) = [f for f in json.loads(out)["findings"] if f["kind"] == "unused-options"]
    assert finding["severity"] == "warning"
    # what asks for nothing is not ignored
    assert finding["text"].startswith("--smooth has no effect in mode attitude")
    assert "warning: --smooth has no effect" in err
    hse = ROOT / "sample_data" / "hse"
    runs, rig = sorted(hse.glob("a-*.mcap")), ("--config", hse / "rig-a.toml")
    assert sinstool("calibrate-hse", *runs, *rig, "-o", tmp_path / "hse.json")[0] == 0
    command = ("process", runs[0], *rig, "--hse", tmp_path / "hse.json", "--smooth")
    status, _, err = sinstool(*command, "-o", tmp_path / "h.mcap")
    assert status == 0 and "warning: --smooth has no effect in mode turntable" in err


def test_flags_win_over_the_file(sinstool, tmp_path):
    (tmp_path / "run.toml").write_text('[align]\nlatitude = 10\n[output]\nworld = "ned"\n')
    _, out, _ = sinstool(
        "process", "--config", tmp_path / "run.toml", "--latitude", "-20.5", "--print-config"
    )
    got = tomllib.loads(out)
    assert (got["align"]["latitude"], got["output"]["world"]) == (-20.5, "ned")


def fields():
    return [
        (group, name)
        for group, field in ProcessConfig.model_fields.items()
        # of a file only, of other commands
        if group not in ("rig", "calibration", "comparison", "export")
        for name in field.annotation.model_fields
        if (group, name) != ("in_flight", "at")  # of `align`
    ]


def test_every_field_is_an_option_and_the_reverse():
    command = cli.get_command(None, "process")
    options = {p.name: p for p in command.params if isinstance(p, click.Option) and "__" in p.name}
    assert {f"{group}__{name}" for group, name in fields()} == set(options)
    for group, name in fields():
        option = options[f"{group}__{name}"]
        assert option.opts == ["--" + name.replace("_", "-")]
        assert option.help, option
    own = {p.name for p in command.params} - set(options)
    assert own == {
        "show_plan",
        "logs",
        "jobs",
        "scheduler",
        "tls_ca",
        "tls_cert",
        "tls_key",
        "output",
        "config_file",
        "show",
        "as_json",
        "quiet",
        "verbose",
        "help_all",
    }
    # names are unique over the groups, as flags must be
    assert len({name for _, name in fields()}) == len(fields())


def test_what_is_told_as_an_option_is_what_the_file_tells(sinstool):
    arguments = [
        "--imu-topic", "/i", "--start", "5", "--imu-rate", "99.5", "--salvage",
        "--coning", "optimal-4", "--gyro-bias", "-0.1,0,2e-3", "--align", "fixed",
        "--initial-attitude", "-1,2,3", "--emit", "euler, pose", "--only-results",
    ]  # fmt: skip
    _, out, _ = sinstool("process", *arguments, "--print-config")
    expected = {
        "input": {"imu_topic": "/i", "start": "5", "imu_rate": 99.5, "salvage": True},
        "coning": {"coning": "optimal-4"},
        "align": {
            "gyro_bias": [-0.1, 0, 2e-3], "align": "fixed", "initial_attitude": [-1, 2, 3]
        },
        "output": {"emit": ["euler", "pose"], "only_results": True},
    }  # fmt: skip
    assert build(ProcessConfig, tomllib.loads(out)) == build(ProcessConfig, expected)
