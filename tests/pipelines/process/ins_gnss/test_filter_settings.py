"""What a filter is set by."""

from dataclasses import replace

import pytest

from sinstool.config import ProcessConfig
from sinstool.core.errors import TopicError
from sinstool.io.readers import open_log
from sinstool.pipelines.process.ins_gnss.filter_settings import barometer
from sinstool.survey.aiding import Barometer
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import simulated


def test_several_barometers_that_nobody_asked_for_do_not_cost_the_position(tmp_path):
    path = simulated(tmp_path / "log.mcap", "drive", "--duration", "40", "--rate", "50")
    problem = TopicError(path, "several topics could be used: /a, /b", "choose one")
    with open_log(path) as log:
        source = prepare(log, ProcessConfig())
        aiding = replace(source.aiding, barometer=Barometer(problem=problem))
        source = replace(source, aiding=aiding)
        assert barometer(source, ProcessConfig()) == (
            None,
            ["no barometer is used: several topics could be used: /a, /b: choose one"],
        )
        for asked in ({"vertical": {"height_damping": "baro"}}, {"input": {"baro_topic": "/a"}}):
            with pytest.raises(TopicError):
                barometer(source, ProcessConfig(**asked))
