"""Commands on many logs: rows, reruns, exit status, and what is left when they are ended."""

import contextlib
import csv
import json
import os
import re
import shutil
import signal
import subprocess
import time
from importlib import metadata
from pathlib import Path

import psutil  # which comes with distributed
import pytest

from sinstool.core.errors import OutputError
from sinstool.pipelines.provenance import read_record
from tests.helpers.imulogs import even_times, handheld, imu_log
from tests.helpers.paths import PROGRAM, ROOT

HSE = ROOT / "sample_data" / "hse"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two good logs and one that is cut short, in folders."""
    top = tmp_path_factory.mktemp("campaign") / "logs"
    for name, seed in {"a/run.mcap": 1, "b/run.mcap": 2, "b/cut.mcap": 3}.items():
        (top / name).parent.mkdir(parents=True, exist_ok=True)
        gyro, accel, _ = handheld(1000, seed=seed, rest_s=1.0)
        imu_log(top / name, even_times(1000), gyro, accel)
    cut = top / "b" / "cut.mcap"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    return top


# Which every run writes anew beside the outputs
INDEX = {"index.html", "summary.csv"}


def files(folder):
    """All files but the index of the outputs."""
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return sorted(names - INDEX if names >= INDEX else names)


def contents(folder):
    """As `files`, with what they hold."""
    return {name: (folder / name).read_bytes() for name in files(folder)}


def rows(out):
    return [json.loads(line) for line in out.splitlines()]


def test_one_bad_log_among_good(sinstool, logs, tmp_path):
    out = tmp_path / "new" / "out"
    status, printed, err = sinstool("process", logs, "-o", out, "-j", 2, "--json")
    assert status == 1
    assert files(out) == ["a/run.mcap", "b/run.mcap"]
    results = rows(printed)
    names = ["a/run.mcap", "b/cut.mcap", "b/run.mcap"]
    assert [row["input"]["path"] for row in results] == [str(logs / name) for name in names]
    assert [row["output"]["path"] for row in results] == [str(out / name) for name in names]
    assert [(row["status"], row["exit"]) for row in results] == [
        ("done", 0),
        ("failed", 1),
        ("done", 0),
    ]
    assert "--salvage" in results[1]["error"]
    assert f"sinstool: {results[1]['error']}\n" in err
    assert "3 logs: 2 done, 1 failed" in err and "Traceback" not in err
    # the rest of a row is what one log says
    alone = tmp_path / "alone.mcap"
    _, single, _ = sinstool("process", logs / "a" / "run.mcap", "-o", alone, "--json")
    expected = json.loads(single)
    row = {k: v for k, v in results[0].items() if k not in ("status", "exit")}
    row["output"]["path"] = str(alone)
    assert row == expected
    assert alone.read_bytes() == (out / "a" / "run.mcap").read_bytes()


def test_salvaged_is_lost(sinstool, logs, tmp_path):
    arguments = ("process", logs / "b", "-o", tmp_path / "out", "--salvage", "-j", 2)
    status, printed, _ = sinstool(*arguments, "--json")
    assert status == 3
    assert [(row["status"], row["exit"]) for row in rows(printed)] == [("lost", 3), ("done", 0)]
    # and stays so when nothing is left to do
    status, printed, _ = sinstool(*arguments, "--json")
    assert status == 3
    assert [(row["status"], row["exit"]) for row in rows(printed)] == [
        ("complete", 3),
        ("complete", 0),
    ]
    # and the tables say which of them it is
    status, printed, _ = sinstool(*arguments)
    assert status == 3
    assert [line.split("  ")[0] for line in printed.splitlines()[1:3]] == [
        "complete (lost)",
        "complete",
    ]
    assert "2 logs: 1 complete, 1 complete (lost)" in printed
    table = (tmp_path / "out" / "summary.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in table[1:]] == ["complete (lost)", "complete"]


def test_what_was_damaged_is_salvaged_later_and_nothing_else_fails(sinstool, logs, tmp_path):
    """The advice of the first run, followed: the other logs are complete, not in the way."""
    arguments = ("process", logs / "b", "-o", tmp_path / "out", "-j", 1, "--json")
    status, printed, err = sinstool(*arguments)
    assert status == 1 and "--salvage" in err
    assert [row["status"] for row in rows(printed)] == ["failed", "done"]
    status, printed, _ = sinstool(*arguments, "--salvage")
    assert status == 3
    assert [row["status"] for row in rows(printed)] == ["lost", "complete"]


def test_the_table_is_printed_though_the_index_cannot_be_written(
    sinstool, logs, tmp_path, monkeypatch
):
    """A disk that is full by then hides nothing of what was done."""

    def full(*_):
        raise OutputError("writing index.html failed: No space left on device")

    monkeypatch.setattr("sinstool.report.pages.campaign.write_index", full)
    status, printed, err = sinstool("process", logs / "a", "-o", tmp_path / "out", "-j", 1)
    assert status == 1 and "index.html failed: No space left" in err
    assert printed.splitlines()[1].startswith("done")


@pytest.mark.slow
def test_a_rerun_makes_only_what_is_not_there(sinstool, logs, tmp_path):
    out = tmp_path / "out"
    arguments = ["process", logs / "*" / "run.mcap", "-o", out, "-j", 1]
    assert sinstool(*arguments)[0] == 0
    before = {name: (out / name).stat().st_mtime_ns for name in files(out)}
    one = (out / "b" / "run.mcap").read_bytes()
    (out / "b" / "run.mcap").unlink()
    status, printed, _ = sinstool(*arguments)
    assert status == 0
    assert [line.split()[0] for line in printed.splitlines()[1:3]] == ["complete", "done"]
    assert (out / "b" / "run.mcap").read_bytes() == one
    assert (out / "a" / "run.mcap").stat().st_mtime_ns == before["a/run.mcap"]
    # whether outputs may be replaced is no part of what they are
    assert sinstool(*arguments, "--overwrite")[0] == 0
    assert (out / "b" / "run.mcap").read_bytes() == one
    assert (out / "a" / "run.mcap").stat().st_mtime_ns != before["a/run.mcap"]


@pytest.mark.slow
@pytest.mark.parametrize("what", ["configuration", "foreign", "cut", "3 bytes", "log", "version"])
def test_another_output_is_refused_for_that_log_only(sinstool, logs, tmp_path, what, monkeypatch):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.mcap").write_bytes((logs / name / "run.mcap").read_bytes())
    arguments = ["process", folder, "-o", out, "-j", 1]
    assert sinstool(*arguments)[0] == 0
    changed = out / "a.mcap"
    if what == "configuration":
        single = ["process", folder / "a.mcap", "-o", changed, "--overwrite"]
        assert sinstool(*single, "--coning", "optimal-2")[0] == 0
    elif what == "foreign":
        changed.write_bytes((folder / "b.mcap").read_bytes())
    elif what == "cut":
        changed.write_bytes(changed.read_bytes()[:-100])
    elif what == "3 bytes":
        changed.write_bytes(changed.read_bytes()[:3])
    elif what == "log":
        (folder / "a.mcap").write_bytes((logs / "b" / "run.mcap").read_bytes())
    else:
        from sinstool.core import version

        with monkeypatch.context() as patched:
            patched.setattr(version, "VERSION", "0.0.1")
            assert sinstool("process", folder / "a.mcap", "-o", changed, "--overwrite")[0] == 0
    before = changed.read_bytes()
    status, printed, err = sinstool(*arguments, "--json")
    assert status == 1
    assert [row["status"] for row in rows(printed)] == ["failed", "complete"]
    said = {
        "configuration": 'another configuration (now coning = "previous-3")',
        "foreign": "no complete output of sinstool",
        "cut": "no complete output of sinstool",
        "3 bytes": "no complete output of sinstool",
        "log": "made of another log",
        "version": "made by sinstool 0.0.1",
    }[what]
    assert said in err and "--overwrite" in err
    assert changed.read_bytes() == before
    assert sinstool(*arguments, "--overwrite")[0] == 0
    assert read_record(changed)["input_name"] == "a.mcap"


@pytest.mark.slow
def test_a_page_for_each(sinstool, logs, tmp_path):
    out, pages = tmp_path / "out", tmp_path / "pages"
    arguments = ["process", logs / "*" / "run.mcap", "-o", out, "--report", pages, "-j", 2]
    assert sinstool(*arguments)[0] == 0
    *made, script = files(pages)
    assert made == ["a/run.html", "b/run.html"] and re.fullmatch(r"figures-\w+\.js", script)
    for name in made:
        assert f'src="../{script}"' in (pages / name).read_text()
    # without its page a log is not complete
    (pages / "b" / "run.html").unlink()
    _, printed, _ = sinstool(*arguments)
    assert [line.split()[0] for line in printed.splitlines()[1:3]] == ["complete", "done"]
    assert files(pages) == [*made, script]
    status, _, err = sinstool(*arguments[:-3], tmp_path / "page.html")
    assert status == 2 and "give a folder" in err


def test_a_table_of_all_logs_stays_right_when_resumed(sinstool, logs, tmp_path):
    out = tmp_path / "out"
    arguments = ["process", logs, "-o", out, "--report", out, "-j", 2]
    status, _, err = sinstool(*arguments)
    assert status == 1
    assert re.search(r"^This run took [\d.]+ s for 3 logs, of which 2 were computed: ", err, re.M)
    first = list(csv.DictReader((out / "summary.csv").open()))
    assert [(Path(row["log"]).name, row["status"]) for row in first] == [
        ("run.mcap", "done"), ("cut.mcap", "failed"), ("run.mcap", "done"),
    ]  # fmt: skip
    assert [row["page"] for row in first] == ["a/run.html", "", "b/run.html"]
    assert [row["output"] for row in first] == ["a/run.mcap", "", "b/run.mcap"]
    assert float(first[0]["duration_s"]) == pytest.approx(4.995)
    assert first[0]["distance_m"] == "" and "no-latitude" in first[0]["findings"].split()
    assert "--salvage" in first[1]["error"]
    page = (out / "index.html").read_text()
    assert page.index("b/cut.mcap") < page.index('<a href="a/run.html">a/run.mcap</a>')
    assert "no-latitude" in page and "2 done" in page
    # The second time nothing is computed, and what was known stays
    (out / "b" / "run.mcap").unlink()
    (out / "b" / "run.html").unlink()
    assert sinstool(*arguments)[0] == 1
    again = list(csv.DictReader((out / "summary.csv").open()))
    assert [row["status"] for row in again] == ["complete", "failed", "done"]
    for before, after in zip(first, again, strict=True):
        assert {**before, "status": ""} == {**after, "status": ""}
    # What is not ours stays
    (out / "summary.csv").write_text("a,b\n")
    status, _, err = sinstool(*arguments)
    assert status == 1 and "is no table of logs" in err
    assert (out / "summary.csv").read_text() == "a,b\n"


def test_no_page_takes_the_place_of_the_table(sinstool, logs, tmp_path):
    named = tmp_path / "in" / "index.mcap"
    named.parent.mkdir()
    named.write_bytes((logs / "a" / "run.mcap").read_bytes())
    out = tmp_path / "out"
    status, _, err = sinstool("process", named.parent, "-o", out, "--report", out)
    assert status == 2 and "the table of all logs" in err


@pytest.mark.slow
def test_what_is_chosen_is_told_log_by_log(sinstool, logs, tmp_path):
    inputs = logs / "*" / "run.mcap"
    status, _, err = sinstool("process", inputs, "-o", tmp_path / "out", "-j", 2, "-v")
    assert status == 0
    choices = [line for line in err.splitlines() if line.startswith("- ")]
    begins = [k for k, line in enumerate(choices) if line.startswith("- log: ")]
    assert [0, len(choices) // 2] == begins
    names = [choices[k].split(": ")[1].split(",")[0] for k in begins]
    assert sorted(names) == [str(logs / name / "run.mcap") for name in ("a", "b")]
    # as of each alone
    for name, k in zip(names, begins, strict=True):
        alone = tmp_path / f"{k}.mcap"
        _, _, err = sinstool("process", name, "-o", alone, "-v")
        assert choices[k : k + begins[1]] == [x for x in err.splitlines() if x.startswith("- ")]
    # where the choices do not begin with the log, its name goes before them
    made = ("--monte-carlo", 1, "-j", 1, "--duration", 1, "-o", tmp_path / "mc")
    _, _, err = sinstool("simulate", "static", *made, "-v")
    assert err.splitlines()[0] == "- log: static-0000.mcap"
    assert err.splitlines()[1].startswith("- scenario: static")
    _, _, err = sinstool("process", inputs, "-o", tmp_path / "quiet", "-j", 2)
    assert "- log" not in err


def test_wrong_usage(sinstool, logs, tmp_path):
    a, b = logs / "a" / "run.mcap", logs / "b" / "run.mcap"
    for arguments, said in (
        ((a, b, "-o", tmp_path / "out"), "would both become"),
        ((logs, "-o", tmp_path / "out", "-j", 2, "--scheduler", "tcp://h:1"), "give one of them"),
        ((a, "-o", tmp_path / "out.mcap", "--scheduler", "tcp://h:1"), "for many logs"),
        ((logs, "-o", tmp_path / "out", "-j", 0), "'-j'"),
    ):
        status, _, err = sinstool("process", *arguments)
        assert status == 2 and said in err, err
    (tmp_path / "file").write_text("x")
    status, _, err = sinstool("process", logs, "-o", tmp_path / "file")
    assert status == 1 and err.startswith("sinstool: ") and "file" in err
    status, _, err = sinstool("process", logs, "-o", tmp_path / "out.mcap")
    assert status == 2 and "give a folder, which gets an output for each" in err
    status, _, err = sinstool("process", a, tmp_path / "none.mcap", "-o", tmp_path / "out")
    assert status == 1 and "there is no such file" in err
    assert not (tmp_path / "out").exists()


def test_one_log_in_a_folder_goes_into_a_folder_too(sinstool, logs, tmp_path):
    """What -o means does not turn on how many logs there are today."""
    for folder in ("new", "there"):
        out = tmp_path / folder
        if folder == "there":
            out.mkdir()
        assert sinstool("process", logs / "a", "-o", out, "-j", 1, "-q")[0] == 0
        assert files(out) == ["run.mcap"]


def test_outputs_among_the_inputs_are_refused(sinstool, logs, tmp_path):
    folder = tmp_path / "in"
    (folder / "day").mkdir(parents=True)
    for name in ("x.mcap", "day/y.mcap"):
        (folder / name).write_bytes((logs / "a" / "run.mcap").read_bytes())
    for inputs in ([folder], [folder / "day"], [folder / "*.mcap"], [folder / "**" / "*.mcap"]):
        status, _, err = sinstool("process", *inputs, "-o", folder)
        assert status == 1
        assert err == (
            f"sinstool: {inputs[0]}: these inputs lie in the folder of the outputs: choose another"
            " folder with -o\n"
        )
    status, _, err = sinstool("process", folder / "x.mcap", logs / "a" / "run.mcap", "-o", folder)
    assert status == 1
    assert err == f"sinstool: {folder}/x.mcap is the input itself: choose another folder with -o\n"
    assert files(folder) == ["day/y.mcap", "x.mcap"]


def test_odd_entries_of_a_folder_stop_nothing(sinstool, logs, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "x.mcap").write_bytes((logs / "a" / "run.mcap").read_bytes())
    (folder / "notes").symlink_to("nowhere")
    (folder / "0loop").symlink_to(".")
    os.mkfifo(folder / "pipe")
    for name, inputs in {"one": folder, "two": folder / "*"}.items():
        out = tmp_path / name
        assert sinstool("process", inputs, "-o", out, "-j", 1, "-q")[0] == 0
        assert len(files(out)) == 1


@pytest.mark.slow
def test_compare_coning(sinstool, logs, tmp_path):
    tables = tmp_path / "tables"
    chosen = ("--algorithms", "previous-3,optimal-2", "--decimate", "1", "-j", 2)
    status, printed, err = sinstool("compare-coning", logs, "--csv", tables, *chosen)
    assert status == 1
    assert files(tables) == [
        "a/run/algorithms.csv", "a/run/pairs.csv",
        "b/run/algorithms.csv", "b/run/pairs.csv", "summary.csv",
    ]  # fmt: skip
    assert re.search(r"^optimal-2 +2 ", printed, re.MULTILINE)
    assert "3 logs: 2 done, 1 failed" in printed
    # warnings of several logs are told once
    assert err.count("less than one window of 10 s") == 1
    status, printed, _ = sinstool("compare-coning", logs, *chosen, "--json")
    results = rows(printed)
    assert [row["status"] for row in results] == ["done", "failed", "done"]
    _, single, _ = sinstool("compare-coning", logs / "a" / "run.mcap", *chosen[:4], "--json")
    expected = json.loads(single)
    drifts = [[alg["drift_dph"] for alg in one["algs"]] for one in (results[0], expected)]
    assert drifts[0] == drifts[1]
    lines = (tables / "summary.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 + 1 + 2
    assert float(lines[1].split(",")[-1]) == pytest.approx(drifts[0][0]["slope_rms"], rel=1e-12)


@pytest.mark.slow
def test_calibrate_hse_is_the_same_by_two(sinstool, tmp_path):
    chosen = ("--config", HSE / "rig-a.toml", "-q")
    made = []
    page, logs = tmp_path / "page.html", sorted(HSE.glob("a-*.mcap"))
    for name, inputs in {
        "one": (*logs, "-j", 1),
        "two": (HSE / "a-*.mcap", "-j", 2, "--report", page),
    }.items():
        path = tmp_path / f"{name}.json"
        assert sinstool("calibrate-hse", *inputs, "-o", path, *chosen)[0] == 0
        made.append({k: v for k, v in json.loads(path.read_text()).items() if k != "created"})
    assert made[0] == made[1]
    # the page names the logs, not the pattern
    html = page.read_text()
    assert len(logs) > 1 and all(f"{log}</" in html for log in logs)
    assert "a-*.mcap" not in html


@pytest.mark.slow
def test_monte_carlo(sinstool, tmp_path):
    scenario = ("simulate", "static", "--duration", 2, "--grade", "mems", "--seed", 7)
    assert sinstool(*scenario, "-o", tmp_path / "two", "--monte-carlo", 3, "-j", 2)[0] == 0
    status, printed, _ = sinstool(*scenario, "-o", tmp_path / "one", "--monte-carlo", 3, "-j", 1,
                               "--json")  # fmt: skip
    assert status == 0
    names = ["static-0007.mcap", "static-0008.mcap", "static-0009.mcap"]
    assert [(row["seed"], row["status"]) for row in rows(printed)] == [
        (7, "done"),
        (8, "done"),
        (9, "done"),
    ]
    assert files(tmp_path / "one") == files(tmp_path / "two") == names
    made = [(tmp_path / "one" / name).read_bytes() for name in names]
    assert made == [(tmp_path / "two" / name).read_bytes() for name in names]
    assert len(set(made)) == 3
    # each is what its seed alone makes
    alone = tmp_path / "alone.mcap"
    assert sinstool(*scenario[:-1], 8, "-o", alone)[0] == 0
    assert alone.read_bytes() == made[1]
    # and is not replaced by itself
    status, printed, err = sinstool(*scenario, "-o", tmp_path / "one", "--monte-carlo", 4, "-j", 1)
    assert status == 1 and err.count("exists already") == 3
    assert [line.split()[0] for line in printed.splitlines()[1:5]] == ["failed"] * 3 + ["done"]
    status, _, err = sinstool(*scenario, "-o", alone, "-j", 2)
    assert status == 2 and "--monte-carlo" in err
    # nor does a folder get the name of a log
    file = tmp_path / "new.mcap"
    status, _, err = sinstool(*scenario, "-o", file, "--monte-carlo", 4)
    assert status == 2 and "give a folder" in err and not file.exists()


def test_the_base_needs_neither_dask_nor_plotly():
    needed = [r for r in metadata.requires("sinstool") if "extra ==" not in r]
    assert needed
    assert not [r for r in needed if re.match(r"(dask|distributed|plotly|matplotlib)\b", r)]
    extras = [r for r in metadata.requires("sinstool") if "cluster" in r]
    assert any(r.startswith("distributed") for r in extras)


# -- ended ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """Logs that take a while."""
    from sinstool.simulation.coning import classical_coning
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.truth import sample_times
    from tests.helpers.motion_topics import motion_topics

    folder = tmp_path_factory.mktemp("large")
    for number in range(4):
        truth = classical_coning(sample_times(1000.0, 80.0 + number, 10**18), 0.3, 3.0)
        write_simulated(folder / f"{number}.mcap", motion_topics(truth, "rate", "flu"), {})
    return folder


def writers(processes, folder):
    """Those of some processes that have an unfinished file of a folder open."""
    busy = []
    for process in processes:
        with contextlib.suppress(psutil.Error):
            if any(file.path.startswith(f"{folder}/.") for file in process.open_files()):
                busy.append(process)
    return busy


def begun(large, out):
    """A run on two workers in the middle of writing, and its processes."""
    run = subprocess.Popen(
        [*PROGRAM, "process", large, "-o", out, "-j", "2", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 120.0
    while time.monotonic() < until and run.poll() is None:
        if any(p.name.startswith(".") for p in out.iterdir()):
            return run, psutil.Process(run.pid).children(recursive=True)
    raise AssertionError(run.communicate())


def ended(processes):
    _, alive = psutil.wait_procs(processes, timeout=30)
    return not alive


@pytest.fixture(scope="module")
def expected(large, tmp_path_factory):
    out = tmp_path_factory.mktemp("expected")
    subprocess.run([*PROGRAM, "process", large, "-o", out, "-j", "2", "-q"], check=True)
    return contents(out)


@pytest.mark.slow
def test_a_worker_is_killed(large, expected, tmp_path):
    run, processes = begun(large, tmp_path)
    while not (writing := writers(processes, tmp_path)):
        assert run.poll() is None
    writing[0].kill()
    stdout, stderr = run.communicate(timeout=300)
    assert run.returncode == 0, stderr
    assert [row["status"] for row in rows(stdout)] == ["done"] * 4
    assert contents(tmp_path) == expected


@pytest.mark.slow
def test_ctrl_c(large, expected, tmp_path):
    run, processes = begun(large, tmp_path)
    run.send_signal(signal.SIGINT)
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 130, stderr
    said = re.findall(r"sinstool: interrupted; (\d) of 4 are complete\n", stderr)
    assert len(said) == 1 and "Traceback" not in stderr
    assert ended(processes)
    # whole files only, and a rerun makes the others
    done = contents(tmp_path)
    assert len(done) >= int(said[0])
    assert all(expected[name] == content for name, content in done.items())
    again = subprocess.run(
        [*PROGRAM, "process", large, "-o", tmp_path, "-j", "2", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    statuses = {Path(row["output"]["path"]).name: row["status"] for row in rows(again.stdout)}
    assert statuses == {name: "complete" if name in done else "done" for name in expected}
    assert contents(tmp_path) == expected


@pytest.mark.slow
def test_workers_do_not_outlive_a_killed_run(large, expected, tmp_path):
    run, processes = begun(large, tmp_path)
    run.kill()
    run.communicate(timeout=60)
    assert ended(processes)
    # A worker that was being started is not among those processes; it ends as well.
    until = time.monotonic() + 30.0
    while unfinished := [p for p in tmp_path.iterdir() if p.name.startswith(".")]:
        assert time.monotonic() < until, unfinished
        time.sleep(0.1)


@pytest.mark.slow
def test_align_over_realisations(sinstool, tmp_path):
    """With errors as large as the accelerometers' biases make them, and the answers of one log."""
    made = ("--monte-carlo", 3, "-j", 1, "--grade", "tactical", "--duration", 40)
    assert sinstool("simulate", "static", "-o", tmp_path / "mc", *made)[0] == 0
    chosen = ("--method", "level", "--truth", "/truth/imu", "--json")
    status, printed, _ = sinstool("align", tmp_path / "mc", *chosen, "-j", 2)
    assert status == 3  # tilt shows no heading
    results = rows(printed)
    for row in results:
        alone, single, _ = sinstool("align", row["input"]["path"], *chosen)
        assert row["exit"] == alone
        assert {k: v for k, v in row.items() if k != "exit"} == json.loads(single)
    errors = [row["truth"]["error_deg"][:2] for row in results]
    assert len({tuple(error) for error in errors}) == 3
    status, printed, _ = sinstool("align", tmp_path / "mc", *chosen[:-1], "-j", 1)
    north, east = ((sum(error[k] ** 2 for error in errors) / 3) ** 0.5 for k in (0, 1))
    assert f"rms error (logs): north {north:.4f} (3), east {east:.4f} (3)" in printed
    status, _, err = sinstool("align", tmp_path / "mc", "--report", tmp_path / "page.html")
    assert status == 2 and "a single log" in err


def shown(*arguments):
    """What a command writes to a terminal on stderr, and to stdout."""
    import pty

    ours, theirs = pty.openpty()
    run = subprocess.Popen(
        [*PROGRAM, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(theirs)
    screen = b""
    with contextlib.suppress(OSError):  # Linux's way of saying that the other end is closed
        while part := os.read(ours, 65536):
            screen += part
    stdout, _ = run.communicate(timeout=120)
    os.close(ours)
    return screen.decode(), stdout.decode()


@pytest.mark.slow
def test_bars_are_for_a_terminal(logs, tmp_path):
    """On stderr, where it is one; lines of JSON stay on stdout."""
    inputs = logs / "*" / "run.mcap"
    text, stdout = shown("process", inputs, "-o", tmp_path / "out", "--json", "-j", 1)
    assert [row["status"] for row in rows(stdout)] == ["done", "done"]
    assert "0 of 2" in text and "2 of 2" in text and "kB" in text
    assert '{"input"' not in text


@pytest.mark.slow
def test_bars_of_what_has_no_input_count_no_bytes(tmp_path):
    made = ("--monte-carlo", 3, "-j", 1, "--duration", 1, "-o", tmp_path / "mc")
    text, _ = shown("simulate", "static", *made)
    assert "3 of 3" in text and "3/3" in text
    assert "byte" not in text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scheduler", "tls://127.0.0.1:1"), "needs --tls-ca and --tls-cert"),
        (("--scheduler", "tls://127.0.0.1:1", "--tls-ca", "FILE"), "needs --tls-ca and --tls-cert"),
        (("--scheduler", "tcp://127.0.0.1:1", "--tls-ca", "FILE"), "go with --scheduler tls://"),
        (("--tls-key", "FILE"), "go with --scheduler tls://"),
    ],
)
def test_encryption_is_asked_for_as_a_whole(sinstool, tmp_path, options, said):
    (tmp_path / "a.pem").write_text("")
    logs = [
        shutil.copy(ROOT / "sample_data/static.mcap", tmp_path / f"{name}.mcap") for name in "ab"
    ]
    given = [tmp_path / "a.pem" if word == "FILE" else word for word in options]
    status, _, err = sinstool("info", *logs, *given)
    assert status == 2
    assert said in err
