"""Which logs are meant, and what their outputs are called."""

import os
from pathlib import Path, PurePath

import pytest

from sinstool.campaign.inputs import are_many, expand, find_logs, is_bag, output_paths
from sinstool.core.errors import ConfigurationError, NotALogError, OutputError, SinstoolError
from tests.helpers.logs import content, write_bag1, write_db3, write_mcap

ROWS = content(20)


@pytest.fixture
def tree(tmp_path):
    """Logs of all kinds at several depths, and what is none."""
    top = tmp_path / "campaign"
    (top / "day1").mkdir(parents=True)
    (top / "day2" / "bag").mkdir(parents=True)
    write_mcap(top / "day1" / "run.mcap", ROWS)
    write_bag1(top / "day1" / "run.bag", content(20, ros=1))
    write_mcap(top / "day2" / "run.mcap", ROWS)
    write_db3(top / "day2" / "bag" / "bag_0.db3", ROWS)
    (top / "day2" / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    write_mcap(top / "without-suffix", ROWS)
    (top / "day1" / "notes.txt").write_text("rain")
    (top / ".hidden.mcap").write_bytes((top / "day1" / "run.mcap").read_bytes())
    return top


NAMES = ["day1/run.bag", "day1/run.mcap", "day2/bag", "day2/run.mcap", "without-suffix"]


def named(logs):
    return sorted(log.name.as_posix() for log in logs)


def test_a_folder_of_logs_is_all_that_are_in_it(tree):
    assert are_many([tree])
    assert named(find_logs([tree])) == NAMES


def test_a_bag_is_one_log(tree):
    bag = tree / "day2" / "bag"
    assert is_bag(bag) and not are_many([bag])
    assert [log.path for log in find_logs([bag])] == [bag]
    # the metadata was lost, but rosbag2's names were not
    (bag / "metadata.yaml").unlink()
    assert is_bag(bag) and not are_many([bag])
    write_db3(bag / "bag_1.db3", ROWS)
    assert is_bag(bag)
    # a part is missing, or it is another log
    write_db3(bag / "bag_7.db3", ROWS)
    assert not is_bag(bag) and are_many([bag])


def test_runs_that_are_numbered_are_many(tmp_path):
    for number in range(3):
        write_mcap(tmp_path / f"drive_{number}.mcap", ROWS)
    assert are_many([tmp_path])
    assert len(find_logs([tmp_path])) == 3


def test_one_log_is_not_many(tree, tmp_path):
    assert not are_many([tree / "day1" / "run.mcap"])
    assert not are_many([tmp_path / "there-is-none.mcap"])
    assert are_many([tree / "day1" / "run.mcap", tree / "day1" / "run.bag"])
    # a log whose name looks like a pattern
    odd = write_mcap(tmp_path / "run[1].mcap", ROWS)
    assert not are_many([odd])


def test_a_folder_with_one_log_is_as_one_with_several(tmp_path):
    for name, write in {
        "run.mcap": write_mcap,
        "run.db3": write_db3,
        "run.bag": write_bag1,
    }.items():
        folder = tmp_path / name.replace(".", "-")
        folder.mkdir()
        write(folder / name, content(20, ros=1) if name == "run.bag" else ROWS)
        assert are_many([folder])
        assert named(find_logs([folder])) == [name]


def test_what_is_no_file_is_passed_over(tree):
    (tree / "gone").symlink_to("nowhere")
    os.mkfifo(tree / "day1" / "pipe")
    assert named(find_logs([tree])) == NAMES
    assert named(find_logs([tree / "*"])) == NAMES
    assert named(find_logs([tree / "**"])) == NAMES


def test_logs_that_hold_nothing_are_not_passed_over(tree):
    """A recorder that lost power leaves empty files: of forty logs, forty are answered for."""
    for name in ("empty.mcap", "zeros.bag", "other.db3", "day1/empty.ulg"):
        (tree / name).write_bytes(b"" if "empty" in name else bytes(4096))
    (tree / "day1" / "notes.md").touch()
    expected = sorted([*NAMES, "empty.mcap", "zeros.bag", "other.db3", "day1/empty.ulg"])
    assert named(find_logs([tree])) == expected
    assert named(find_logs([tree / "**"])) == expected


def test_links_that_lead_back(tree):
    (tree / "0loop").symlink_to(".")
    (tree / "day1" / "0up").symlink_to("..")
    assert named(find_logs([tree])) == NAMES
    assert named(find_logs([tree / "**"])) == NAMES
    assert named(find_logs([tree / "*"])) == NAMES
    assert named(find_logs([tree / "**" / "*.mcap"])) == ["day1/run.mcap", "day2/run.mcap"]


def test_links_that_lead_elsewhere_are_followed(tree, tmp_path):
    (tmp_path / "disk").mkdir()
    write_mcap(tmp_path / "disk" / "run.mcap", ROWS)
    (tree / "day3").symlink_to(tmp_path / "disk")
    assert "day3/run.mcap" in named(find_logs([tree]))
    assert "day3/run.mcap" in named(find_logs([tree / "**" / "*.mcap"]))


def test_patterns(tree):
    assert are_many([tree / "*" / "run.mcap"])
    assert named(find_logs([tree / "*" / "run.mcap"])) == ["day1/run.mcap", "day2/run.mcap"]
    assert named(find_logs([tree / "*"])) == NAMES
    assert named(find_logs([tree / "**" / "*.mcap"])) == ["day1/run.mcap", "day2/run.mcap"]
    with pytest.raises(NotALogError, match="matches no log"):
        find_logs([tree / "*.txt"])


def test_a_log_counts_once(tree):
    again = [tree / "day1", tree / "day1" / "run.mcap", tree / "day1" / "*.mcap"]
    assert named(find_logs(again)) == ["run.bag", "run.mcap"]


def test_outputs_are_not_inputs(tree):
    folder = tree / "day2"
    assert named(find_logs([tree], without=folder)) == NAMES[:2] + NAMES[-1:]


def test_inputs_among_the_outputs(tree):
    for path in (tree, tree / "day1", tree / "day1" / "*.mcap", tree / "**" / "*.mcap"):
        with pytest.raises(
            OutputError, match="in the folder of the outputs: choose another"
        ) as info:
            find_logs([path], without=tree)
        assert str(path) in str(info.value)
    with pytest.raises(OutputError, match=r"run\.mcap is the input itself"):
        output_paths(find_logs([tree / "day1" / "run.mcap"]), tree / "day1")
    # a page beside its log has another name
    assert output_paths(find_logs([tree / "day1" / "run.mcap"]), tree / "day1", ".html")


def test_what_is_not_there(tree, tmp_path):
    with pytest.raises(NotALogError, match="no such file"):
        find_logs([tree, tmp_path / "nowhere.mcap"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(NotALogError, match="holds no log"):
        find_logs([tmp_path / "empty"])


def test_outputs_are_laid_out_as_the_inputs(tree):
    out = PurePath("out")
    paths = output_paths(find_logs([tree]), Path("out"))
    assert sorted(p.relative_to(out).as_posix() for p in paths) == [
        "day1/run.bag.mcap",
        "day1/run.mcap",
        "day2/bag.mcap",
        "day2/run.mcap",
        "without-suffix.mcap",
    ]
    pages = output_paths(find_logs([tree / "day1"]), Path("out"), ".html")
    assert sorted(map(str, pages)) == ["out/run.bag.html", "out/run.html"]


def test_outputs_never_collide(tree):
    logs = [tree / "day1" / "run.mcap", tree / "day2" / "run.mcap"]
    with pytest.raises(ConfigurationError, match="would both become") as info:
        output_paths(find_logs(logs), Path("out"))
    assert str(logs[0]) in str(info.value) and str(logs[1]) in str(info.value)
    # as the hint says
    assert len(set(output_paths(find_logs([tree / "*" / "run.mcap"]), Path("out")))) == 2


def test_no_output_in_a_bag(tree):
    bag = tree / "day2" / "bag"
    with pytest.raises(SinstoolError, match="input's own folder"):
        output_paths(find_logs([bag, tree / "day1"]), bag / "out")


def test_what_is_no_folder_of_logs_stays_as_it_was_given(tree, tmp_path):
    nowhere = tmp_path / "nowhere.mcap"
    one = tree / "day1" / "run.mcap"
    assert expand([one, nowhere, one]) == [one, nowhere, one]
    assert expand([tree / "day1"]) == [tree / "day1" / "run.bag", one]
