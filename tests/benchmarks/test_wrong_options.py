"""Options of logs that are hunted, which need not suit the log, but which the command takes."""

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.wrong_options import WITH_GNSS, WITHOUT_GNSS, with_gnss, without_gnss
from sinstool.cli.main import cli
from sinstool.core.rotation import from_euler, to_dcm


@pytest.mark.parametrize(
    "name, word",
    sorted((n, w) for kinds in (WITH_GNSS, WITHOUT_GNSS) for n in kinds for w in kinds[n]),
)
def test_every_option_is_one_of_the_command(name, word):
    ran = CliRunner().invoke(cli, ["process", "--print-config", name, word], standalone_mode=False)
    assert ran.exception is None and ran.return_value == 0, ran.exception


@pytest.mark.parametrize(
    "draw, without_value",
    [
        (lambda random: with_gnss(random, np.eye(3)), set(WITH_GNSS)),
        (without_gnss, set(WITHOUT_GNSS)),
    ],
)
def test_every_kind_is_drawn_and_taken(draw, without_value):
    random = np.random.default_rng(1)
    drawn = {tuple(draw(random)) for _ in range(2000)}
    assert without_value <= {words[0] for words in drawn}
    others = [words for words in drawn if words[0] not in without_value or len(words) > 2]
    assert others
    for words in others[:40]:
        ran = CliRunner().invoke(cli, ["process", "--print-config", *words], standalone_mode=False)
        assert ran.exception is None and ran.return_value == 0, (words, ran.exception)


def test_a_stated_attitude_is_off_in_roll_or_heading_or_not_at_all():
    c_nb, random = to_dcm(from_euler(np.deg2rad([10.0, -20.0, 30.0]))), np.random.default_rng(2)
    drawn = [with_gnss(random, c_nb) for _ in range(3000)]
    stated = [words[3] for words in drawn if words[:2] == ["--align", "fixed"]]
    off = np.array([[float(x) for x in text.split(",")] for text in stated]) - [10.0, -20.0, 30.0]
    assert np.count_nonzero(off[:, 1]) == 0
    assert np.all(np.count_nonzero(off, axis=1) <= 1)
    assert {0.0, 5.0, 180.0} <= set(off[:, 0]) & set(off[:, 2])
