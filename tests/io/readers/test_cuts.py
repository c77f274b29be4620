"""Logs cut short anywhere (`benchmarks/every_cut.py` cuts them at every byte)."""

import pytest

from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log
from tests.helpers.logs import read_back
from tests.io.readers.cuts import LOGS, expected

pytestmark = pytest.mark.slow

# No divisor of anything, so that cuts fall on all sorts of places
STEP = 61


@pytest.mark.parametrize("name", LOGS)
def test_what_is_recovered_never_becomes_less(tmp_path, name):
    path = LOGS[name](tmp_path)
    data = path.read_bytes()
    cut_path = path.with_name(f"cut{path.suffix}")
    most = 0
    for cut in (*range(0, len(data), STEP), len(data)):
        cut_path.write_bytes(data[:cut])
        listed = []
        try:
            with open_log(cut_path, salvage=True) as log:
                listed = read_back(log)
                assert cut == len(data) or log.lost
        except SinstoolError as exc:
            assert "\n" not in str(exc)
        assert listed == expected(name)[: len(listed)]
        assert len(listed) >= most
        most = len(listed)
    with open_log(path) as log:
        assert listed == read_back(log)
