"""`sinstool export` as it is typed: what it prints, refuses and leaves behind."""

from __future__ import annotations

import json
from typing import get_args

import pandas
import pytest

import sinstool as package
from sinstool.config import ExportOptions
from sinstool.core.errors import ConfigurationError
from sinstool.core.whole_file import EXPORTED
from sinstool.pipelines.export.run import WRITERS
from tests.helpers.paths import ROOT

STATIC = ROOT / "sample_data" / "static.mcap"
CONING = ROOT / "sample_data" / "coning.mcap"


@pytest.fixture
def result(sinstool, tmp_path):
    path = tmp_path / "static.result.mcap"
    assert sinstool("process", STATIC, "-o", path, "--mode", "attitude", "-q")[0] == 0
    return path


def test_the_summary_names_rows_columns_and_frame(sinstool, result, tmp_path):
    status, out, err = sinstool("export", result, "-o", tmp_path / "x.csv", "--rate", 10, "-v")
    assert status == 0 and not err.replace("- log", "")[1:].startswith("warning")
    words = " ".join(out.split())
    assert f"result {result}: 2001 attitudes over 20.000 s in frame odom" in words
    assert "thinned to 10 rows per second at most (--rate)" in words
    assert f"written {tmp_path / 'x.csv'}: 201 rows, " in words
    assert "columns time_ns, time_s, q_nb_w" in words
    assert sinstool("export", result, "-o", tmp_path / "y.csv", "-q")[1:] == ("", "")


def test_json_is_the_same_in_the_dialect_of_all_commands(sinstool, result, tmp_path):
    status, out, _ = sinstool("export", result, "-o", tmp_path / "x.tum", "--json")
    values = json.loads(out)
    assert status == 0 and values["schema"] == "sinstool.export/1"
    assert values["input"]["frame"] == "odom" and values["input"]["rows"] == 2001
    output = values["output"]
    assert output["format"] == "tum" and output["first_ns"] == values["input"]["first_ns"]
    assert int(output["last_ns"]) - int(output["first_ns"]) == 20_000_000_000
    assert values["position"] is False and values["warnings"] == []


def test_a_tum_file_without_positions_says_so(sinstool, result, tmp_path):
    _, out, _ = sinstool("export", result, "-o", tmp_path / "x.tum")
    assert "none in the result: x, y and z are 0" in out


def test_mistakes_are_one_line_and_leave_nothing(sinstool, result, tmp_path):
    kept = sorted(tmp_path.iterdir())
    for words, said in (
        ((result, "-o", tmp_path / "x.kml"), "has no position, and .kml is made of positions"),
        ((result, "-o", tmp_path / "x.xls"), "its suffix .xls is no format of sinstool export"),
        ((result, "-o", tmp_path / "x.jsn"), "did you mean"),
        ((result, "-o", tmp_path / "x"), "it has no suffix of sinstool export"),
        ((STATIC, "-o", tmp_path / "x.csv"), "it is not a result of sinstool"),
        ((result, "-o", tmp_path / "x.csv", "--format", "kml"), "contradict each other"),
        ((result, "-o", tmp_path / "x.csv", "--start", "99"), "no row between --start and --end"),
        ((result, "-o", tmp_path / "x.csv", "--start", "99"), "s, from 2023-11-14 22:13:20.0"),
        ((result, "-o", tmp_path / "x.csv", "--start", "noon"), "is not a time"),
        ((result, "-o", tmp_path / "x.csv", "--start=2", "--end=1"), "--end is not after --start"),
        ((result, "-o", tmp_path / "no" / "x.csv"), "does not exist"),
        ((result, result, "-o", tmp_path / "x.csv"), "with many results give a folder"),
        ((result, result, "-o", tmp_path / "folder"), "give the format with --format"),
        ((result,), "give the output with -o FILE"),
        ((), "give a RESULT"),
    ):
        status, out, err = sinstool("export", *words)
        assert status in (1, 2) and not out, words
        assert said in err and len(err.strip().splitlines()[-1]) < 400, (words, err)
        assert sorted(tmp_path.iterdir()) == kept, words


def test_many_results_become_a_file_each(sinstool, result, tmp_path):
    other = tmp_path / "coning.mcap"
    assert sinstool("process", CONING, "-o", other, "-q", "--gyro-kind", "mean-rate")[0] == 0
    status, out, _ = sinstool(
        "export", tmp_path, "-o", tmp_path / "tables", "--format", "csv", "--rate", 1, "-j", 1
    )
    assert status == 0 and "2 logs: 2 done" in out
    files = sorted((tmp_path / "tables").iterdir())
    assert [path.name for path in files] == ["coning.csv", "static.result.csv"]
    assert [len(pandas.read_csv(path)) for path in files] == [24, 21]


def test_a_configuration_holds_its_options(sinstool, result, tmp_path):
    _, printed, _ = sinstool("export", "--print-config", "--rate", 5, "--start", 2)
    (tmp_path / "run.toml").write_text(printed)
    assert sinstool("export", "--print-config", "--config", tmp_path / "run.toml")[1] == printed
    words = ("export", result, "-o", tmp_path / "x.csv", "--config", tmp_path / "run.toml", "-q")
    assert sinstool(*words)[0] == 0
    frame = pandas.read_csv(tmp_path / "x.csv")
    assert len(frame) == 91 and frame.time_s.iloc[0] == 2.0


def test_a_damaged_result_is_refused_and_salvaged(sinstool, result, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(result.read_bytes()[:-200_000])
    status, _, err = sinstool("export", cut, "-o", tmp_path / "x.csv")
    assert status == 1 and "--salvage" in err and not (tmp_path / "x.csv").exists()
    status, _, err = sinstool("export", cut, "-o", tmp_path / "x.csv", "--salvage")
    assert status == 3 and "lost" in err and "its axes are taken as FLU in ENU" in err
    whole = tmp_path / "whole.csv"
    assert sinstool("export", result, "-o", whole)[0] == 0
    kept = (tmp_path / "x.csv").read_text().splitlines()
    assert 2 < len(kept) < 2002 and kept == whole.read_text().splitlines()[: len(kept)]


@pytest.mark.parametrize("suffix", [".kml", ".csv", ".GPX", ".parquet", ".json", ".bag", ".txt"])
def test_an_output_of_process_and_simulate_is_an_mcap(sinstool, tmp_path, suffix):
    """Refused at once, with the command that writes such a file."""
    name = tmp_path / f"my drive{suffix}"
    mcap = name.with_suffix(".mcap")
    status, out, err = sinstool("process", STATIC, "-o", name)
    assert (status, out) == (2, "") and f"-o {name}: the output is an MCAP: give -o {mcap}" in err
    if suffix.lower() in EXPORTED:
        assert f"`sinstool export '{mcap}' -o '{name}'`" in err
    else:
        assert "`sinstool export` converts it to .csv, .parquet, .tum, .kml, .gpx, .geojson" in err
    status, out, err = sinstool("simulate", "static", "-o", name)
    assert (status, out) == (2, "") and "from the output of `sinstool process`" in err
    assert sinstool("process", STATIC, "-o", name, "--json")[0] == 2
    with pytest.raises(ConfigurationError, match="the output is an MCAP"):
        package.process(STATIC, name)
    assert not list(tmp_path.iterdir())


def test_outputs_of_many_logs_are_not_one_table(sinstool, tmp_path):
    status, _, err = sinstool("process", STATIC, CONING, "-o", tmp_path / "x.csv")
    assert status == 2 and "give a folder" in err and "sinstool export" in err
    status, _, err = sinstool("align", STATIC, "--series", tmp_path / "x.kml")
    assert status == 2 and f"give --series {tmp_path / 'x.csv'}" in err
    assert not list(tmp_path.iterdir())


def test_every_format_of_export_is_known_to_the_other_commands():
    assert tuple(f".{name}" for name in WRITERS) == EXPORTED
    (words,) = [one for one in get_args(ExportOptions.model_fields["format"].annotation)
                if get_args(one)]  # fmt: skip
    assert get_args(words) == tuple(WRITERS)
