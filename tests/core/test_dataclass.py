"""Our `dataclass` makes what that of the standard library makes."""

import copy
import dataclasses
import operator
import pickle
from dataclasses import FrozenInstanceError, field, replace

import pytest

from sinstool.core import dataclass as ours

MAKERS = {"theirs": dataclasses.dataclass, "ours": ours.dataclass}


def classes(dataclass):
    """The same classes by either."""

    @dataclass(frozen=True)
    class Point:
        x: float
        y: float = 2.0
        about: str = field(default="", compare=False)
        hidden: list = field(default_factory=list, repr=False, compare=False)

    @dataclass(frozen=True)
    class Place(Point):
        z: float = 0.0

        def __post_init__(self):
            object.__setattr__(self, "_sum", self.x + self.y + self.z)

    @dataclass(frozen=True, kw_only=True)
    class Named(Place):
        name: str

    @dataclass(frozen=True, repr=False)
    class Brief:
        x: float

        def __repr__(self):
            return "brief"

    @dataclass(frozen=True, repr=False)
    class Briefer(Brief):
        y: float = 0.0

    @dataclass(frozen=True, eq=False)
    class Itself:
        x: float

    @dataclass(frozen=True)
    class Near:
        x: float

        def __eq__(self, other):
            return abs(self.x - other.x) < 1.0

    @dataclass(frozen=True, order=True)
    class Ranked:
        x: float

    @dataclass
    class Open:
        x: float

    return {each.__name__: each for each in locals().values() if isinstance(each, type)}


THEIRS, OURS = (classes(maker) for maker in MAKERS.values())
VALUES = {
    "Point": [((1.0,), {}), ((1.0, 3.0, "here"), {}), ((1.0, 2.0), {"hidden": [1]})],
    "Place": [((1.0,), {}), ((1.0, 3.0, "here"), {"z": 4.0})],
    "Named": [((1.0,), {"name": "a"}), ((1.0,), {"name": "b"})],
    "Brief": [((1.0,), {}), ((2.0,), {})],
    "Briefer": [((1.0,), {}), ((1.0, 2.0), {})],
    "Itself": [((1.0,), {}), ((1.0,), {})],
    "Near": [((1.0,), {}), ((1.5,), {})],
    "Ranked": [((1.0,), {}), ((2.0,), {})],
    "Open": [((1.0,), {}), ((2.0,), {})],
}


def outcome(work, *args):
    """What comes of it, be it an error."""
    try:
        return work(*args)
    except Exception as exc:
        return type(exc)


def same_hash(one):
    return hash(one) == hash(copy.copy(one))


def account(cls, values):
    """All that can be seen of instances of a class."""
    made = [cls(*args, **keywords) for args, keywords in values]
    yield [repr(one) for one in made]
    yield [[one == other for one in made] for other in made]
    yield [outcome(operator.ne, one, 1) for one in made]
    yield [outcome(same_hash, one) for one in made]
    yield [outcome(operator.lt, one, made[0]) for one in made]
    yield [dataclasses.asdict(one) for one in made]
    yield [repr(replace(one, x=7.0)) for one in made]
    yield [vars(copy.deepcopy(one)) for one in made]
    yield [outcome(setattr, one, "x", 1.0) for one in made]
    yield [outcome(delattr, one, "x") for one in made]
    yield [outcome(setattr, one, "new", 1.0) for one in made]
    yield outcome(cls)
    yield [(f.name, f.init, f.compare, f.kw_only) for f in dataclasses.fields(cls)]
    yield cls.__match_args__


@pytest.mark.parametrize("name", VALUES)
def test_looks_and_behaves_the_same(name):
    theirs, ours_ = (list(account(each[name], VALUES[name])) for each in (THEIRS, OURS))
    assert ours_ == theirs


def test_values_within_themselves_are_shown():
    one = OURS["Point"](1.0, hidden=[])
    round_ = OURS["Place"](1.0, about=[])
    round_.about.append(round_)
    assert repr(round_).endswith("about=[...], z=0.0)")
    assert hash(one) == hash(OURS["Point"](1.0))


@ours.dataclass(frozen=True)
class Sent:
    x: float
    more: tuple = ()


def test_goes_between_processes():
    sent = Sent(1.0, (2, "a"))
    assert pickle.loads(pickle.dumps(sent)) == sent
    with pytest.raises(FrozenInstanceError, match="cannot assign to field 'x'"):
        sent.x = 2.0


def test_frozen_classes_have_one_set_of_methods():
    shared = ("__eq__", "__hash__", "__repr__", "__setattr__", "__delattr__")
    point, named = OURS["Point"], OURS["Named"]
    assert [vars(point)[name] for name in shared] == [vars(named)[name] for name in shared]
