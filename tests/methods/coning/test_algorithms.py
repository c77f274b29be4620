import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.algorithm import ConingAlgorithm, MultiSampleAlgorithm
from sinstool.methods.coning.lags import lag_coefficients, optimal, previous, uncompensated
from sinstool.methods.coning.registry import algorithm, names
from sinstool.methods.coning.savage import SavageTwoSpeed

EVERY = [
    *names(),
    "savage-two-speed-1",
    "savage-two-speed-7",
    "previous-6",
    "optimal-8",
    "optimal-3-previous-2",
    "picard-2",
    "quatfiter-3",
    "lookahead-4",
    "lookahead-16",
]
FORMS = [(name, kind) for name in EVERY for kind in ("mean-rate", "rate")]


def samples(count, seed=1):
    rng = np.random.default_rng(seed)
    x = rng.normal([0.03, -0.05, 0.01], 0.02, size=(count, 3))
    return x, rng.uniform(0.002, 0.003, size=count)


def lag_reference(x, first, size, history):
    """One update by its definition, with numpy's cross product and exact weights."""
    last = first + size - 1
    weights = lag_coefficients(size, history)
    earlier = sum((float(w) * x[last - m] for m, w in enumerate(weights, 1)), np.zeros(3))
    return x[first : last + 1].sum(axis=0) + np.cross(earlier, x[last])


def savage_reference(x, first, size, before):
    alpha, beta = np.zeros(3), np.zeros(3)
    for row in x[first : first + size]:
        beta = beta + 0.5 * np.cross(alpha + before / 6.0, row)
        alpha = alpha + row
        before = row
    return alpha + beta


@pytest.mark.parametrize(("build", "size"), [(previous, (1, 2, 3)), (optimal, (2, 3, 4, 5, 6))])
def test_lag_families_by_their_definition(build, size):
    x, dt = samples(40)
    for n in size:
        a = build(n)
        answers = a.rotation_vectors(x, dt, 5, 5)
        for update in range(5):
            expected = lag_reference(x, 5 + update * a.samples, a.samples, a.before)
            np.testing.assert_allclose(answers[update], expected, rtol=1e-14)


def test_start_of_a_segment_uses_the_sharpest_set_that_fits():
    x, dt = samples(12)
    answers = previous(3).rotation_vectors(x, dt, 0, 6)
    for row, history in enumerate([0, 1, 2, 3, 3, 3]):
        np.testing.assert_allclose(answers[row], lag_reference(x, row, 1, history), rtol=1e-14)
    np.testing.assert_array_equal(answers[0], x[0])
    np.testing.assert_allclose(answers[1], x[1] + np.cross(x[0], x[1]) / 12, rtol=1e-14)


def test_uncompensated_is_the_increment():
    x, dt = samples(9)
    np.testing.assert_array_equal(uncompensated().rotation_vectors(x, dt, 2, 7), x[2:])


@pytest.mark.parametrize("size", [1, 2, 4, 5])
def test_savage_by_its_recursion(size):
    x, dt = samples(30)
    answers = SavageTwoSpeed(size).rotation_vectors(x, dt, 3, 4)
    for update in range(4):
        start = 3 + update * size
        expected = savage_reference(x, start, size, x[start - 1])
        np.testing.assert_allclose(answers[update], expected, rtol=1e-14)


def test_savage_is_its_relatives_where_they_meet():
    x, dt = samples(30)
    # one sample per update: the twelfth of the previous one
    np.testing.assert_allclose(
        SavageTwoSpeed(1).rotation_vectors(x, dt, 1, 29),
        previous(1).rotation_vectors(x, dt, 1, 29),
        rtol=1e-14,
    )
    # two samples and nothing before them: two thirds
    np.testing.assert_allclose(
        SavageTwoSpeed(2).rotation_vectors(x[:2], dt[:2], 0, 1),
        optimal(2).rotation_vectors(x[:2], dt[:2], 0, 1),
        rtol=1e-14,
    )
    np.testing.assert_array_equal(SavageTwoSpeed(1).rotation_vectors(x, dt, 0, 1), x[:1])


@pytest.mark.parametrize(("name", "kind"), FORMS)
def test_an_update_depends_on_nothing_but_its_window(name, kind):
    a = algorithm(name).for_kind(kind)
    assert (a.name, a.samples) == (algorithm(name).name, algorithm(name).samples)
    x, dt = samples(110)
    first, count = 21, 6
    together = a.rotation_vectors(x, dt, first, count)
    for update in range(count):
        start = first + update * a.samples
        rows = slice(start - a.before, start + a.samples + a.after)
        alone = a.rotation_vectors(x[rows], dt[rows], a.before, 1)
        np.testing.assert_array_equal(together[update], alone[0])
        poisoned, strange = np.full_like(x, np.nan), np.full_like(dt, np.nan)
        poisoned[rows], strange[rows] = x[rows], dt[rows]
        answer = a.rotation_vectors(poisoned, strange, start, 1)
        np.testing.assert_array_equal(together[update], answer[0])


@pytest.mark.parametrize(("name", "kind"), FORMS)
def test_a_constant_rate_is_integrated_exactly(name, kind):
    a = algorithm(name).for_kind(kind)
    rate = np.array([0.7, -1.1, 0.4])
    dt = np.full(30, 0.004)
    x = np.tile(rate if a.takes == "rates" else rate * 0.004, (30, 1))
    answers = a.rotation_vectors(x, dt, 3, 3)
    np.testing.assert_allclose(answers, np.tile(rate * 0.004 * a.samples, (3, 1)), rtol=1e-14)


@pytest.mark.parametrize(("name", "kind"), FORMS)
def test_turned_samples_give_turned_answers(name, kind):
    a = algorithm(name).for_kind(kind)
    x, dt = samples(40)
    q = rotation.exp([0.8, -2.0, 0.5])
    straight = a.rotation_vectors(x, dt, 4, 4)
    turned = a.rotation_vectors(rotation.rotate(q, x), dt, 4, 4)
    np.testing.assert_allclose(turned, rotation.rotate(q, straight), rtol=1e-12)


def test_an_algorithm_of_several_samples_says_what_ends_a_segment():
    class One(ConingAlgorithm):
        def _fill(self, x, dt, first, out):
            out[:] = x[first : first + len(out)]

    class Several(MultiSampleAlgorithm):
        _fill = One._fill

    with pytest.raises(AttributeError, match="samples"):
        One().samples = 2
    with pytest.raises(TypeError, match="_of_samples"):
        Several()


@pytest.mark.parametrize("name", EVERY)
def test_what_is_left_at_the_end_is_of_the_same_order(name):
    a = algorithm(name)
    for size in range(1, a.samples + 1):
        b = a.shorter(size)
        assert b.samples == size
        assert b.takes == a.takes
        # as many samples within reach, so that the order of the error does not fall
        assert b.before + b.samples + b.after >= min(a.before + a.samples + a.after, size + 1)
        with pytest.raises(ValueError, match="not 0 are left"):
            a.shorter(0)
    with pytest.raises(ValueError, match="are left"):
        a.shorter(a.samples + 1)
    np.testing.assert_array_equal(
        *(b.rotation_vectors(*samples(30), 2, 3) for b in (a, a.shorter(a.samples)))
    )


def test_shorter_optimal_takes_earlier_samples_for_the_missing_ones():
    x, dt = samples(20)
    for left in (1, 2, 3):
        answer = optimal(4).shorter(left).rotation_vectors(x, dt, 8, 1)
        np.testing.assert_allclose(answer[0], lag_reference(x, 8, left, 4 - left), rtol=1e-14)
        answer = optimal(4).shorter(left).rotation_vectors(x, dt, 0, 1)
        np.testing.assert_allclose(answer[0], lag_reference(x, 0, left, 0), rtol=1e-14)


@pytest.mark.parametrize("name", EVERY)
def test_bad_windows_are_refused(name):
    a = algorithm(name)
    x, dt = samples(a.samples + 1)
    assert a.rotation_vectors(x, dt, 1, 1).shape == (1, 3)
    assert a.rotation_vectors(x, dt, 1, 0).shape == (0, 3)
    for first, count in ((1, 2), (2, 1), (-1, 1), (1, -1)):
        with pytest.raises(ValueError, match="do not fit"):
            a.rotation_vectors(x, dt, first, count)
    if a.takes == "rates":
        with pytest.raises(ValueError, match="do not fit"):
            a.rotation_vectors(x, dt, 0, 1)
    with pytest.raises(ValueError, match="`x`"):
        a.rotation_vectors(x[:, :2], dt, 1, 1)
    with pytest.raises(ValueError, match="`dt`"):
        a.rotation_vectors(x, dt[1:], 1, 1)


def test_samples_in_any_memory_layout():
    x, dt = samples(20)
    a = algorithm("previous-3")
    strided = np.asfortranarray(np.repeat(x, 2, axis=0))[::2]
    np.testing.assert_array_equal(
        a.rotation_vectors(strided, dt, 3, 10), a.rotation_vectors(x, dt, 3, 10)
    )


def test_registry_knows_the_names_of_the_command_line():
    promised = {
        "uncompensated", "previous-1", "previous-2", "previous-3", "optimal-2", "optimal-3",
        "optimal-4", "optimal-5", "optimal-6", "savage-4", "savage-two-speed",
        "singular-perturbation", "picard-4", "quatfiter-4", "lookahead-12", "gyro-tuned",
    }  # fmt: skip
    assert promised <= set(names())
    for name in names():
        a = algorithm(name)
        assert a.name == name or (name, a.name) == ("savage-4", "optimal-4")
        assert a.summary and a.source
    assert algorithm("savage-two-speed").samples == 4
    assert algorithm("savage-two-speed-9").samples == 9


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("previous3", "previous-3"),
        ("optimal-99", "optimal-"),
        ("singular_perturbation", "singular-perturbation"),
        ("none", "did you mean"),
        ("", "did you mean"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(wrong, meant):
    with pytest.raises(ConfigurationError) as error:
        algorithm(wrong)
    assert repr(wrong) in error.value.message
    assert meant in f"did you mean {error.value.hint}"


def test_options_where_there_are_none_are_refused():
    with pytest.raises(ConfigurationError, match="no option epsilon") as error:
        algorithm("previous-1", epsilon=1e-3)
    assert "choose singular-perturbation" in error.value.hint
    with pytest.raises(ConfigurationError, match="no option passband") as error:
        algorithm("singular-perturbation", passband=60.0, epsilon=1e-3)
    assert "choose gyro-tuned" in error.value.hint
    with pytest.raises(ConfigurationError, match="no option nonsense") as error:
        algorithm("gyro-tuned", nonsense=1)
    assert error.value.hint == "leave it out"
    with pytest.raises(ConfigurationError, match="savage-two-speed-0"):
        algorithm("savage-two-speed-0")
