"""Records behave as the dataclasses of the standard library that they stand for."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from dataclasses import FrozenInstanceError, field
from functools import cached_property
from typing import Any

import pytest

from sinstool.core import record


def _classes(decorator: Any) -> dict[str, Any]:
    """The same classes, made by one decorator or the other."""

    @decorator(frozen=True)
    class Place:
        """Of a vehicle."""

        north: float
        east: float = 2.0
        tags: tuple[str, ...] = ()
        seen: list[int] = field(default_factory=list, repr=False, compare=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "north", float(self.north))

        @cached_property
        def sum(self) -> float:
            """Something that is kept."""
            return self.north + self.east

    @decorator(frozen=True)
    class Marked(Place):
        """With one field more."""

        mark: str = "x"

    @decorator
    class Count:
        """That changes."""

        n: int = 0

    @decorator(frozen=True, repr=False)
    class Named:
        """With a text of its own."""

        n: int

        def __repr__(self) -> str:
            return f"number {self.n}"

    @decorator(frozen=True, eq=False)
    class Identity:
        """Equal to itself alone."""

        n: int = 1

    @decorator(frozen=True, kw_only=True)
    class ByName:
        """Whose fields have to be named."""

        n: int

    return {each.__name__: each for each in (Place, Marked, Count, Named, Identity, ByName)}


OURS, THEIRS = _classes(record.dataclass), _classes(dataclasses.dataclass)


def test_fields_text_and_comparison_are_the_same() -> None:
    for name, args in (
        ("Place", (1,)),
        ("Place", (1, 3.0, ("a",), [4])),
        ("Marked", (1, 2.0, (), [], "y")),
        ("Count", (3,)),
        ("Named", (3,)),
    ):
        ours, theirs = OURS[name](*args), THEIRS[name](*args)
        assert repr(ours).replace(OURS[name].__qualname__, "") == repr(theirs).replace(
            THEIRS[name].__qualname__, ""
        )
        assert dataclasses.asdict(ours) == dataclasses.asdict(theirs)
        assert ours == OURS[name](*args)
        assert ours != theirs
    assert OURS["Place"](1) == OURS["Place"](1, seen=[5])  # which is not compared
    assert OURS["Place"](1) != OURS["Place"](2)
    assert OURS["Place"](1, 2.0) != OURS["Marked"](1, 2.0)


def test_hashes_are_the_same() -> None:
    assert hash(OURS["Place"](1)) == hash(THEIRS["Place"](1))
    assert OURS["Count"].__hash__ is None
    with pytest.raises(TypeError, match="unhashable"):
        hash(OURS["Count"]())


def test_without_comparison_it_is_equal_to_itself_alone() -> None:
    one, other = OURS["Identity"](), OURS["Identity"]()
    assert one == one
    assert one != other
    assert len({one, other}) == 2


@pytest.mark.parametrize("classes", [OURS, THEIRS], ids=["ours", "theirs"])
def test_frozen_ones_cannot_be_changed(classes: dict[str, Any]) -> None:
    place = classes["Marked"](1)
    for name in ("north", "mark", "other"):
        with pytest.raises(FrozenInstanceError, match=name):
            setattr(place, name, 3.0)
    with pytest.raises(FrozenInstanceError, match="east"):
        del place.east
    assert vars(place) == {"north": 1.0, "east": 2.0, "tags": (), "seen": [], "mark": "x"}
    assert place.sum == 3.0  # kept without being set
    count = classes["Count"]()
    count.n = 4
    assert count == classes["Count"](4)


def test_copies_and_changed_copies() -> None:
    place = OURS["Marked"](1, mark="z")
    assert dataclasses.replace(place, north=5) == OURS["Marked"](5, mark="z")
    assert copy.deepcopy(place) == place
    assert copy.copy(place) == place


def test_those_of_modules_are_pickled() -> None:
    from sinstool.core.finding import Finding

    finding = Finding("kind", "text")
    assert pickle.loads(pickle.dumps(finding)) == finding


def test_fields_that_have_to_be_named() -> None:
    with pytest.raises(TypeError):
        OURS["ByName"](1)
    assert OURS["ByName"](n=1).n == 1


def test_text_of_what_holds_itself() -> None:
    place = OURS["Place"](1)
    place.seen.append(place)
    assert "north=1.0" in repr(place)
    holder = OURS["Count"]()
    holder.n = holder
    assert "..." in repr(holder)
