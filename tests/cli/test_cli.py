import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest

from sinstool.cli.main import COMMANDS, cli
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.english import heading_text
from sinstool.methods.coning.registry import names
from tests.helpers.imulogs import (
    REAL,
    even_times,
    handheld,
    imu_log,
    imu_messages,
    read_topic,
    resting,
    write_log,
)
from tests.helpers.logs import PRESSURE, Row, payload_of, real, write_mcap
from tests.helpers.paths import ROOT

PROGRAM = [sys.executable, "-c", "from sinstool.cli.main import main; main()"]


@pytest.fixture
def log(tmp_path):
    """A good log, alone in its folder."""
    folder = tmp_path / "logs"
    folder.mkdir()
    gyro, accel, _ = handheld(1000, rest_s=2.0)
    return imu_log(folder / "good.mcap", even_times(1000), gyro, accel)


def one_line(err):
    """The one line of an error, and nothing of Python in it."""
    lines = err.strip().split("\n")
    assert len(lines) == 1, err
    assert lines[0].startswith("sinstool: ")
    assert "Traceback" not in err
    return lines[0]


def usage(err):
    line = one_line(err)
    assert line.endswith(" --help")
    return line


# -- bad inputs ------------------------------------------------------------------------------


def missing(folder):
    return folder / "nope.mcap", "there is no such file"


def empty(folder):
    path = folder / "empty.mcap"
    path.write_bytes(b"")
    return path, "the file is empty"


def text(folder):
    path = folder / "text.mcap"
    path.write_text("time,gyro\n1,2\n")
    return path, "not a log"


def directory(folder):
    path = folder / "folder"
    path.mkdir()
    return path, "metadata.yaml"


def cut(folder):
    path = imu_log(folder / "cut.mcap", even_times(5000), *resting(5000))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path, "--salvage"


def no_imu(folder):
    payload = payload_of(PRESSURE, 0)
    return write_mcap(folder / "b.mcap", [Row("/baro", 1, 1, payload)]), "no sensor_msgs/Imu topic"


def ambiguous(folder):
    times = even_times(100)
    messages = [m for t in ("/a", "/b") for m in imu_messages(times, *resting(100), topic=t)]
    return write_log(folder / "two.mcap", messages), "--imu-topic"


def deg_s(folder):
    gyro, accel, _ = handheld(4000)
    return imu_log(
        folder / "deg.mcap", even_times(4000), np.degrees(gyro), accel
    ), "--gyro-unit deg/s"


def in_g(folder):
    gyro, accel, _ = handheld(1000)
    return imu_log(folder / "g.mcap", even_times(1000), gyro, accel / 9.8), "--accel-unit g"


def slow(folder):
    return imu_log(folder / "slow.mcap", even_times(60, 1.0), *resting(60)), "1 samples a second"


def not_a_number(folder):
    return imu_log(folder / "nan.mcap", even_times(9), [np.nan] * 3, [0.0, 0, 9.8]), "hold NaN"


BAD = [
    missing, empty, text, directory, cut, no_imu, ambiguous, deg_s, in_g, slow, not_a_number
]  # fmt: skip


@pytest.mark.parametrize("make", BAD, ids=lambda f: f.__name__)
@pytest.mark.parametrize("options", [(), ("--json",), ("-q",)])
def test_bad_inputs_end_in_one_line(sinstool, tmp_path, make, options):
    path, expected = make(tmp_path)
    before = sorted(p.name for p in tmp_path.rglob("*"))
    status, out, err = sinstool("process", path, "-o", tmp_path / "out.mcap", *options)
    line = one_line(err)
    assert status == 1
    if "--json" in options:
        failure = {"schema": "sinstool.error/1", "status": "failed", "exit": 1}
        assert json.loads(out) == {**failure, "error": line.removeprefix("sinstool: ")}
    else:
        assert out == ""
    assert expected in line and str(path) in line
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_output_exists(sinstool, log, tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    status, _, err = sinstool("process", log, "-o", out)
    assert status == 1 and "exists already" in one_line(err) and "--overwrite" in err
    assert out.read_bytes() == b"precious"
    status, _, err = sinstool("process", log, "-o", out, "--overwrite")
    assert status == 0 and "Traceback" not in err
    assert len(read_topic(out, "/sinstool/attitude")) == 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == ["logs", "out.mcap"]


@pytest.mark.parametrize("options", [(), ("--overwrite",)])
@pytest.mark.parametrize("way", ["itself", "dotted", "symlink", "hardlink"])
def test_output_is_the_input(sinstool, log, options, way):
    out = log
    if way == "dotted":
        out = log.parent / ".." / log.parent.name / log.name
    elif way != "itself":
        out = log.parent / "other.mcap"
        (os.symlink if way == "symlink" else os.link)(log, out)
    before = log.read_bytes()
    status, _, err = sinstool("process", log, "-o", out, *options)
    assert status == 1 and "is the input itself" in one_line(err)
    assert log.read_bytes() == before


@pytest.mark.parametrize(
    ("out", "expected"),
    [
        ("/proc/out.mcap", "/proc"),  # not even root writes there
        ("nowhere/out.mcap", "does not exist"),
        ("logs", "is a folder"),
        ("logs/good.mcap/out.mcap", "does not exist"),
    ],
)
def test_unwritable_places(sinstool, log, tmp_path, monkeypatch, out, expected):
    if out.startswith("/proc") and not Path("/proc").is_dir():
        pytest.skip("no /proc on this system")
    monkeypatch.chdir(tmp_path)
    status, _, err = sinstool("process", log, "-o", out)
    assert status == 1 and expected in one_line(err)
    assert [p.name for p in tmp_path.rglob("*")] == ["logs", "good.mcap"]


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """So large that processing it takes a while."""
    from sinstool.simulation.coning import classical_coning
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.truth import sample_times
    from tests.helpers.motion_topics import motion_topics

    path = tmp_path_factory.mktemp("large") / "large.mcap"
    truth = classical_coning(sample_times(1000.0, 200.0, 10**18), 0.3, 3.0)
    write_simulated(path, motion_topics(truth, "rate", "flu"), {})
    return path


def has_open(process, path):
    """Whether a process has a file open; True also where the system does not say."""
    files = Path(f"/proc/{process.pid}/fd")
    if not files.is_dir():
        return True
    try:
        return any(os.path.realpath(f) == str(path) for f in files.iterdir())
    except OSError:  # one was closed meanwhile
        return False


@pytest.mark.slow
@pytest.mark.parametrize("when", ["while it reads", "while it writes"])
def test_ctrl_c(large, tmp_path, when):
    run = subprocess.Popen(
        [*PROGRAM, "process", large, "-o", tmp_path / "out.mcap"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and run.poll() is None:
        if when == "while it reads" and has_open(run, large):
            break
        if any(p.stat().st_size for p in tmp_path.iterdir()):
            break
    assert run.poll() is None
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=30)
    assert run.returncode == 130, stderr.decode()
    assert one_line(stderr.decode()) == "sinstool: interrupted; nothing was written"
    assert stdout == b""
    assert list(tmp_path.iterdir()) == []


# -- configuration ---------------------------------------------------------------------------

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


# -- help ------------------------------------------------------------------------------------


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        "cli.main(['--help'], standalone_mode=False)\n"
        "print('loaded', sorted({m.split('.')[0] for m in sys.modules}))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    shown, loaded = run.stdout.split("loaded ")
    heavy = {"numpy", "numba", "scipy", "pydantic", "rich", "mcap", "rosbags", "zstandard", "lz4"}
    assert heavy & set(re.findall(r"'(\w+)'", loaded)) == set()
    assert all(name in shown for name in COMMANDS)


def test_printing_a_configuration_compiles_nothing():
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        "cli.main(['process', '--print-config'], standalone_mode=False)\n"
        "print('loaded', sorted({m.split('.')[0] for m in sys.modules}))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = re.findall(r"'(\w+)'", run.stdout.split("loaded ")[1])
    assert {"scipy", "rosbags", "mcap", "rich"} & set(loaded) == set()


def loaded_by(words):
    """Modules that a command has imported, the second time, with its kernels compiled."""
    code = (
        "import sys\nfrom sinstool.cli.main import cli\n"
        f"cli.main({words!r}, standalone_mode=False)\n"
        "print('loaded', sorted(sys.modules))"
    )
    for _ in range(2):
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return re.findall(r"'([\w.]+)'", run.stdout.split("loaded ")[1])


@pytest.mark.slow
def test_a_run_imports_only_what_it_uses(tmp_path):

    out = str(tmp_path / "out.mcap")
    words = ["process", str(ROOT / "sample_data/static.mcap"), "-o", out, "--overwrite", "-q"]
    loaded = loaded_by([*words, "--mode", "attitude"])
    others = {"scipy.linalg", "scipy.spatial", "scipy.special", "numba", "numpy.f2py"}
    assert others & set(loaded) == set()
    assert {"sinstool.report.markup", "rosbags.typesys.stores.ros2_dashing"} & set(loaded) == set()


@pytest.mark.slow
def test_a_filter_runs_without_scipy(sinstool, tmp_path):
    """Importing it takes longer than filtering ten minutes."""
    log, out = str(tmp_path / "drive.mcap"), str(tmp_path / "out.mcap")
    assert sinstool("simulate", "drive", "-o", log, "--duration", "200", "--rate", "50")[0] == 0
    words = ["process", log, "-o", out, "--overwrite", "-q", "--mode", "ins-gnss", "--smooth"]
    loaded = loaded_by(words)
    assert {"scipy", "numba"} & set(loaded) == set()


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS), ("simulate", "coning")])
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help(sinstool, command, flag):
    status, out, err = sinstool(*command, flag)
    assert (status, err) == (0, "")
    assert out.startswith("Usage: ")


def test_help_of_process_names_every_algorithm_and_option(sinstool):
    _, out, _ = sinstool("process", "--help-all")
    help_text = " ".join(out.split())
    assert all(name in help_text for name in names())
    assert all("--" + name.replace("_", "-") in help_text for _, name in fields())


@pytest.mark.parametrize("command", [("export",), ("simulate", "drive"), ("conventions",)])
def test_where_help_is_all_help_all_is_the_same(sinstool, command):
    """The README says of every command that --help-all shows all of its options."""
    short, full = (sinstool(*command, flag) for flag in ("--help", "--help-all"))
    assert full[0] == 0 and full[1] == short[1] and "--help-all" not in short[1]


LONG = ("info", "process", "align", "compare-coning", "calibrate-hse")


@pytest.mark.parametrize("command", LONG)
def test_help_fits_a_screen_and_the_full_help_is_in_groups(sinstool, command):
    short, full = (sinstool(command, flag)[1] for flag in ("--help", "--help-all"))
    assert len(short.strip().split("\n")) <= 60
    assert max(map(len, short.split("\n"))) <= 100
    assert re.search(r"--help-all +show all \d+ options", short)
    headings = re.findall(r"^(\S[^:\n]*):$", full, re.M)
    assert headings[0] == "Main options" and headings[-1] == "Messages"
    assert len(headings) == len(set(headings)) >= 5
    # all of the short help's options are in the full one, which has more
    options = [set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", text, re.M)) for text in (short, full)]
    assert options[0] <= options[1] and len(options[1]) > len(options[0])


def test_what_matters_most_comes_first(sinstool):
    lines = sinstool("process", "--help")[1].split("Main options:\n")[1].split("\n")
    first = re.findall(r"--[\w-]+", "\n".join(lines[:6]))
    assert {"--output", "--mode", "--smooth", "--report"} <= set(first)


def test_version(sinstool):
    from sinstool import __version__

    assert sinstool("--version") == (0, f"sinstool, version {__version__}\n", "")
    module = subprocess.run(
        [sys.executable, "-m", "sinstool", "--version"], capture_output=True, text=True, check=True
    )
    assert module.stdout.endswith(f", version {__version__}\n") and not module.stderr


# -- what is printed -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heading", "text"),
    [(0.0, "0.000"), (-0.0, "0.000"), (-1e-7, "0.000"), (359.9997, "0.000"), (-107.3944, "252.606"),
     (180.0, "180.000"), (-180.0, "180.000")],
)  # fmt: skip
def test_headings_go_round_the_compass(heading, text):
    assert heading_text(heading, 3) == text


KEYS = {
    "input": {"path", "size", "sha256"},
    "imu": {"topic", "n", "rate_hz", "gaps", "dropped"},
    "alignment": {
        "method", "time_ns", "roll_deg", "pitch_deg", "heading_deg", "sigma_deg", "status"
    },
    "final": {
        "time_ns", "q_wxyz_ned_frd", "roll_deg", "pitch_deg", "heading_deg", "lat_deg", "lon_deg",
        "height_m",
    },
    "coning": {"algorithm"},
    "output": {"path"},
    "lost": {"parts"},
}  # fmt: skip


def test_json_is_one_object_with_the_keys_of_the_contract(sinstool, log, tmp_path):
    status, out, err = sinstool("process", log, "-o", tmp_path / "out.mcap", "--json")
    assert status == 0
    summary = json.loads(out)
    assert summary["schema"] == "sinstool.process/1"
    beside = {"schema", "plan", "hse", "smoothing", "height", "filter", "findings", "warnings"}
    beside |= {"travel"}
    assert set(KEYS) | beside == set(summary)
    for key, inside in KEYS.items():
        assert inside <= set(summary[key]), key
    assert summary["imu"]["n"] == 1000 and summary["imu"]["topic"] == "/imu"
    assert summary["hse"] is summary["height"] is summary["filter"] is None
    # times are strings of nanoseconds: JSON's numbers would lose their end
    times = even_times(1000)
    assert summary["alignment"]["time_ns"] == str(times[0])
    assert summary["final"]["time_ns"] == str(times[-1])
    assert len(summary["alignment"]["sigma_deg"]) == 3
    assert np.linalg.norm(summary["final"]["q_wxyz_ned_frd"]) == pytest.approx(1.0)
    assert summary["output"]["path"] == str(tmp_path / "out.mcap")
    # warnings are in the object, and on stderr for people
    assert summary["warnings"] and all(f"warning: {w}\n" in err for w in summary["warnings"])


def test_summary_and_silence(sinstool, log, tmp_path):
    status, out, _ = sinstool("process", log, "-o", tmp_path / "a.mcap")
    assert status == 0
    assert "1000 samples at 200.000 Hz" in out and "level (ok)" in out and "previous-3" in out
    assert "sha256" not in out
    status, out, _ = sinstool("process", log, "-o", tmp_path / "b.mcap", "-v")
    assert "sha256" in out
    status, out, err = sinstool("process", log, "-o", tmp_path / "c.mcap", "-q")
    assert (status, out) == (0, "")
    assert all(line.startswith("warning: ") for line in err.splitlines())


def test_verbose_errors_have_their_traceback(tmp_path):
    run = subprocess.run(
        [*PROGRAM, "process", "-vv", tmp_path / "no.mcap", "-o", tmp_path / "o.mcap"],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1 and "Traceback" in run.stderr and "no such file" in run.stderr


def test_a_steady_turn_is_not_called_rest(sinstool, tmp_path):
    """A table that turns at a constant rate: its noise is that of rest, its rate no bias."""
    gyro, accel = resting(1000)
    turning = np.add(gyro, [0.0, 0.0, np.radians(90.0)])
    path = write_log(tmp_path / "a.mcap", imu_messages(even_times(1000), turning, accel))
    _, out, _ = sinstool("info", path)
    assert re.search(r"^  steady .* it turns at this rate, or the gyro's bias is large$", out, re.M)
    assert not re.search(r"^  still", out, re.M)
    _, _, err = sinstool("process", path, "-o", tmp_path / "a.out.mcap")
    assert "90.0 deg/s, is removed as the gyro's bias" in err and "--gyro-bias none" in err
    told = ("--gyro-bias", "none")
    _, _, err = sinstool("process", path, "-o", tmp_path / "b.out.mcap", *told)
    assert "is removed" not in err
    slow = np.add(gyro, [0.0, 0.0, np.radians(4.0)])
    path = write_log(tmp_path / "c.mcap", imu_messages(even_times(1000), slow, accel))
    _, _, err = sinstool("process", path, "-o", tmp_path / "c.out.mcap")
    assert "deg/s, is removed" not in err


def test_something_lost(sinstool, tmp_path):
    """Malformed messages, and parts of a damaged log that were passed over."""
    messages = imu_messages(even_times(1000), *resting(1000))
    messages[500] = messages[500]._replace(message=b"\x00\x01\x00\x00")
    path = write_log(tmp_path / "a.mcap", messages)
    status, out, err = sinstool("process", path, "-o", tmp_path / "a.out.mcap", "--json")
    assert status == 3
    assert json.loads(out)["lost"]["malformed"] == 1
    assert "1 message does not fit" in err
    path, _ = cut(tmp_path)
    status, out, err = sinstool("process", path, "-o", tmp_path / "b.out.mcap")
    assert status == 1 and err.count("\n") == 1
    assert f"`sinstool process {path} -o {tmp_path / 'b.out.mcap'} --salvage`" in err
    status, out, err = sinstool(
        "process", path, "-o", tmp_path / "b.out.mcap", "--salvage", "--json"
    )
    assert status == 3
    lost = json.loads(out)["lost"]
    assert lost["parts"] and all(part in err for part in lost["parts"])
    places = lost["places"]
    assert [place["text"] for place in places] == lost["parts"]
    assert all(place["offset"] > 0 and place["start_ns"].isdigit() for place in places)
    status, out, _ = sinstool("info", path, "--salvage")
    assert status == 3 and "lost: " in out
    status, out, _ = sinstool("info", path, "--salvage", "--json")
    assert status == 3 and json.loads(out)["lost"]["parts"] == lost["parts"]


@pytest.mark.parametrize("path", REAL)
def test_info_on_every_real_log(sinstool, path):
    axes = ("--body-axes", "frd") if path.startswith("px4") else ()
    status, out, err = sinstool("info", real(path), "--json", *axes)
    assert (status, err) == (0, "")
    result = json.loads(out)
    assert result["process"]["possible"] and result["lost"]["parts"] == []
    imu = next(i for i in result["imu"] if i["topic"] == result["process"]["imu_topic"])
    assert imu["n"] > 1000 and imu["first_ns"].isdigit()
    assert [f for f in imu["findings"] if f["severity"] == "failed"] == []
    assert sum(t["n"] for t in result["topics"]) == result["input"]["messages"]
    status, out, err = sinstool("info", real(path), *axes)
    assert (status, err) == (0, "")
    assert f"IMU {imu['topic']}" in out and f"process would use {imu['topic']}" in out
    assert all(f["text"] in out for f in imu["findings"])


def test_info_says_what_process_would_say(sinstool, tmp_path):
    for make in (ambiguous, deg_s, in_g, slow, no_imu, not_a_number):
        path, expected = make(tmp_path)
        status, out, err = sinstool("info", path)
        assert (status, err) == (0, "")
        assert "process would refuse this log" in out and expected in out
        status, out, _ = sinstool("info", path, "--json")
        verdict = json.loads(out)["process"]
        assert status == 0 and not verdict["possible"] and expected in verdict["why"]


@pytest.mark.parametrize("make", [missing, empty, text, cut], ids=lambda f: f.__name__)
def test_info_refuses_what_is_no_log(sinstool, tmp_path, make):
    path, expected = make(tmp_path)
    status, out, err = sinstool("info", path)
    assert status == 1 and out == "" and expected in one_line(err)


def test_info_takes_the_input_options(sinstool, log):
    _, out, _ = sinstool("info", log, "--start", "1", "--end", "3", "--json")
    (imu,) = json.loads(out)["imu"]
    assert (imu["n"], imu["covered_s"]) == (401, 2.0)
    assert sinstool("info", log, "--imu-topic", "/x")[0] == 0  # the verdict says it
    _, out, _ = sinstool("info", log, "--imu-topic", "/x", "--json")
    assert json.loads(out)["imu"] == [] and "/x" in json.loads(out)["process"]["why"]


# -- simulate --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "options", "expected"),
    [
        ("coning", ("--rate", "0"), "--rate 0.0: must be greater than 0"),
        ("coning", ("--rate", "nan"), "--rate nan: must be"),
        ("coning", ("--rate", "inf"), "--rate inf: must be"),
        ("coning", ("--duration", "-1"), "--duration -1.0: must be greater than 0"),
        ("coning", ("--duration", "inf"), "--duration inf: must be"),
        ("coning", ("--duration", "1e-4"), "shorter than one sample interval"),
        ("coning", ("--seed", "-1"), "--seed -1: must be greater than or equal to 0"),
        ("coning", ("--frequency", "nan"), "--frequency nan: must be"),
        ("coning", ("--lead-in", "-1"), "--lead-in -1.0: must be greater than or equal to 0"),
        ("coning", ("--lead-in", "nan"), "--lead-in nan: must be"),
        ("coning", ("--half-angle-deg", "90"), "--half-angle-deg 90.0: must be less than 90"),
        ("coning", ("--half-angle-deg", "nan"), "--half-angle-deg nan: must be"),
        ("coning", ("--grade", "best"), "'best' is not one of"),
        ("static", ("--latitude", "91"), "--latitude 91.0: must be less than or equal to 90"),
        ("static", ("--longitude", "nan"), "--longitude nan: must be"),
        ("static", ("--height", "inf"), "--height inf: must be a finite number"),
        ("static", ("--attitude", "1,2"), "'1,2' is not 3 numbers"),
        ("static", ("--attitude", "1,2,nan"), "must be a finite number"),
        ("static", ("--duration", "0"), "--duration 0.0: must be greater than 0"),
    ],
)
def test_simulate_refuses_bad_values(sinstool, tmp_path, scenario, options, expected):
    status, out, err = sinstool("simulate", scenario, "-o", tmp_path / "o.mcap", *options)
    assert status == 2 and out == "" and expected in err.strip().split("\n")[-1]
    assert list(tmp_path.iterdir()) == []


def test_simulate_takes_a_file_and_prints_it(sinstool, tmp_path):
    file = tmp_path / "drive.toml"
    file.write_text("[simulate]\nrate = 20.0\nduration = 5.0\ngnss_outage = ['1:2']\n")
    made = ("simulate", "drive", "--config", file, "--duration", "4")
    _, out, _ = sinstool(*made, "--print-config")
    options = tomllib.loads(out)["simulate"]
    assert (options["rate"], options["duration"], options["gnss_outage"]) == (20.0, 4.0, ["1:2"])
    status, out, err = sinstool(*made, "-o", tmp_path / "d.mcap", "-q")
    assert (status, out, err) == (0, "", "")
    file.write_text("[simulate]\nrte = 20.0\n")
    status, _, err = sinstool(*made, "-o", tmp_path / "e.mcap")
    assert status == 2 and "unknown key simulate.rte: did you mean rate?" in one_line(err)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["coning", "static"])
def test_simulate_and_process(sinstool, tmp_path, scenario):
    path, out_path = tmp_path / "in.mcap", tmp_path / "out.mcap"
    options = ("--duration", "3", "--grade", "mems", "--seed", "5")
    status, out, _ = sinstool("simulate", scenario, "-o", path, *options, "--json")
    counts = json.loads(out)["topics"]
    assert status == 0 and counts["/imu/data_raw"] == counts["/truth/odometry"] == 1201
    status, _, err = sinstool("simulate", scenario, "-o", path, *options)
    assert status == 1 and "exists already" in one_line(err)
    before = path.read_bytes()
    assert sinstool("simulate", scenario, "-o", path, *options, "--overwrite")[0] == 0
    assert path.read_bytes() == before  # the same seed, the same file
    assert (
        sinstool(
            "process", path, "-o", out_path, "--align", "level" if scenario == "static" else "auto"
        )[0]
        == 0
    )
    assert len(read_topic(out_path, "/sinstool/attitude")) == 1201
