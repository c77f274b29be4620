from tests.helpers import results


def test_definitions_of_results_are_those_of_rosbags():
    """They are made by ``python -m tests.helpers.results``."""
    assert results.PATH.read_text() == results.content()
