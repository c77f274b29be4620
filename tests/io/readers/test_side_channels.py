"""What a pass holds of small topics is what another pass over the log would give."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.io.readers import open_log, side_channels
from sinstool.io.readers.batch import RawBatch
from tests.helpers.logs import content, read_back, write_bag1, write_db3, write_mcap

TWICE = {"channels": {"/imu": 2, "/baro": 2}}
LOGS = {
    "zstd": lambda p: write_mcap(p / "a.mcap", content(), **TWICE),
    "none": lambda p: write_mcap(p / "a.mcap", content(), compression="none", **TWICE),
    "db3": lambda p: write_db3(p / "a.db3", content()),
    "bag": lambda p: write_bag1(p / "a.bag", content(300, 1), connections=2),
}


@pytest.fixture(scope="module", params=LOGS)
def path(request, tmp_path_factory):
    return LOGS[request.param](tmp_path_factory.mktemp("side"))


def alone(path, channels):
    """What a log gives that was never told to hold anything."""
    with open_log(path) as log:
        return read_back(log, channels)


def passes(log):
    """The passes over a log from now on."""
    walk, seen = log._read, []

    def counted(expected):
        seen.append(expected)
        return walk(expected)

    log._read = counted
    return seen


def test_one_pass_serves_all_who_want_small_topics(path):
    with open_log(path) as log:
        first, *others = sorted(log.channels)
        seen = passes(log)
        log.cache(others)
        assert read_back(log, [first]) == alone(path, [first])
        for expected in (others, others[-1:], []):
            assert read_back(log, expected) == alone(path, expected)
        assert len(seen) == 1
        assert read_back(log) == alone(path, None)  # for all topics there has to be another
        assert len(seen) == 2


@pytest.mark.slow
@given(st.data())
def test_any_channels_in_any_order(path, data):
    with open_log(path) as log:
        some = st.lists(st.sampled_from(sorted(log.channels)), unique=True)
        log.cache(data.draw(some))
        for expected in data.draw(st.lists(st.none() | some, max_size=4)):
            assert read_back(log, expected) == alone(path, expected)


def test_a_pass_that_is_broken_off_holds_nothing(path):
    with open_log(path) as log:
        first, *others = sorted(log.channels)
        log.cache(others)
        begun = log.batches([first])
        next(begun)
        assert read_back(log, others) == alone(path, others)  # meanwhile, and holds nothing
        begun.close()
        assert read_back(log, others) == alone(path, others)


def test_what_is_too_large_is_read_again(path, monkeypatch):
    monkeypatch.setattr(side_channels, "MAX_BYTES", 1000)
    with open_log(path) as log:
        first, *others = sorted(log.channels)
        log.cache(others)
        seen = passes(log)
        for expected in ([first], others, others):
            assert read_back(log, expected) == alone(path, expected)
        assert len(seen) == 3


def test_what_is_held_is_answered_with_piece_by_piece(path, monkeypatch):
    monkeypatch.setattr(side_channels, "ROWS", 7)
    with open_log(path) as log:
        first, *others = sorted(log.channels)
        log.cache(others)
        read_back(log, [first])
        assert read_back(log, others) == alone(path, others)
        assert max(len(batch) for batch in log.batches(others)) <= 7


def test_messages_without_a_payload_are_held():
    cache = side_channels.SideChannelCache([1])
    numbers = np.arange(3)
    cache.begin()
    cache.add(RawBatch(np.zeros(0, np.uint8), numbers * 0 + 1, *[numbers * 0] * 2, *[numbers] * 3))
    cache.end(True)
    (batch,) = cache.batches([1])
    np.testing.assert_array_equal(batch.log_time, numbers)
    assert not batch.length.any()


def test_what_is_held_takes_its_memory_once():
    size, count = 200, 1000
    payload = np.arange(size * count, dtype=np.int64).astype(np.uint8).reshape(count, size)
    cache = side_channels.SideChannelCache([1])
    times = np.arange(count)
    cache.begin()
    tracemalloc.start()
    try:
        for _ in range(100):
            cache.add(RawBatch.from_rows(1, payload, times, times))
        held, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        cache.end(True)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 100 * size * count < held < 100 * count * (1.2 * size + 60)
    assert max(after, peak) < 1.15 * held
    batches = list(cache.batches([1]))
    assert sum(len(batch) for batch in batches) == 100 * count
    last = batches[-1]
    begin = last.offset[-1]
    np.testing.assert_array_equal(last.buffer[begin : begin + size], payload[-1])


def test_what_is_known_of_messages_counts_as_well(monkeypatch):
    payload, times = np.zeros((10, 4), np.uint8), np.arange(10)
    for most, holds in ((10 * (4 + 6 * 8), True), (10 * (4 + 6 * 8) - 1, False)):
        monkeypatch.setattr(side_channels, "MAX_BYTES", most)
        cache = side_channels.SideChannelCache([1])
        cache.begin()
        for first in (0, 5):
            part = slice(first, first + 5)
            cache.add(RawBatch.from_rows(1, payload[part], times[part], times[part]))
        assert bool(cache.channels) == holds
