"""The fields of a message type, from the schema text in a log.

The grammar of ``.msg`` and ROS IDL files is rosbags' trade; this module only asks it, fills
in what logs leave out, and says clearly what it cannot use.
"""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

# rosbags is imported where it is asked, as with its parsers that takes longer than to read a small
# log: what the usual types look like lies beside this module.

# The largest standard schema has 12 kB; a hostile one must not cost the time to parse it.
MAX_SCHEMA = 2**20
# Serialisations that are read
ENCODINGS = ("cdr", "ros1")
SCHEMA_ENCODINGS = ("ros2msg", "ros1msg", "ros2idl", "")
# How deep types may nest, and how many may hang on one another before that is known
MAX_DEPTH, MAX_CHAIN = 32, 256
# Paths of one type in another that are looked for at most
MAX_PATHS = 64


class DefinitionError(ValueError):
    """A schema cannot be parsed or names a type that is defined nowhere."""


@dataclass(frozen=True)
class FieldType:
    """One field's type.

    Attributes
    ----------
    kind : {'base', 'message', 'array', 'sequence'}
        A primitive, a nested message, a fixed-length array or a variable-length sequence.
    name : str
        Of the primitive or message; of the element for arrays and sequences.
    element : {'base', 'message', ''}
        Kind of the element of an array or a sequence.
    count : int
        Length of a fixed array, else 0.
    """

    kind: str
    name: str
    element: str = ""
    count: int = 0


@dataclass(frozen=True)
class Definition:
    """A message type with everything nested in it.

    Attributes
    ----------
    name : str
        Normalised ROS 2 spelling, ``package/msg/Type``.
    encoding : {'cdr', 'ros1'}
        Serialisation the layout is meant for.
    types : dict
        Type name to its ordered ``(field name, FieldType)`` pairs.
    """

    name: str
    encoding: str
    types: dict[str, tuple[tuple[str, FieldType], ...]]

    def fields(self, name: str) -> tuple[tuple[str, FieldType], ...]:
        """Fields of a nested type; DefinitionError when it is defined nowhere."""
        try:
            return self.types[name]
        except KeyError:
            raise DefinitionError(f"type {name} is not defined in the schema") from None

    def has(self, path: str) -> bool:
        """Whether a message has a field at a dotted path, outside of arrays."""
        here = self.name
        *outer, last = path.split(".")
        for name in outer:
            field = dict(self.types.get(here, ())).get(name)
            if field is None or field.kind != "message":
                return False
            here = field.name
        return last in dict(self.types.get(here, ()))

    def paths_of(self, type_name: str) -> Iterator[str]:
        """Dotted paths at which a type is nested ('' for the message itself), 64 at most."""
        holding: dict[str, bool] = {type_name: True}
        self._holds(self.name, holding)
        yield from islice(self._paths_of(self.name, type_name, "", holding), MAX_PATHS)

    def _holds(self, here: str, holding: dict[str, bool]) -> bool:
        """Whether a type nests another; each type is searched once."""
        if here not in holding:
            nested = [f.name for _, f in self.types.get(here, ()) if f.kind == "message"]
            inside = [self._holds(name, holding) for name in nested]  # all of them, not the first
            holding[here] = any(inside)
        return holding[here]

    def _paths_of(
        self, here: str, target: str, prefix: str, holding: dict[str, bool]
    ) -> Iterator[str]:
        if here == target:
            yield prefix
            return
        for field, ftype in self.types[here]:
            if ftype.kind == "message" and holding[ftype.name]:
                path = f"{prefix}.{field}" if prefix else field
                yield from self._paths_of(ftype.name, target, path, holding)


def normalise_type_name(name: str) -> str:
    """``sensor_msgs/Imu`` and ``sensor_msgs/msg/Imu`` both to the latter."""
    parts = name.strip("/").split("/")
    if len(parts) == 2:
        return f"{parts[0]}/msg/{parts[1]}"
    return "/".join(parts)


def ros1_type_name(name: str) -> str:
    """``sensor_msgs/msg/Imu`` to ``sensor_msgs/Imu``."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


@lru_cache(maxsize=256)
def parse_definition(type_name: str, schema_encoding: str, text: str, encoding: str) -> Definition:
    """Parse the schema of a topic.

    Parameters
    ----------
    type_name : str
        The topic's type, in ROS 1 or ROS 2 spelling.
    schema_encoding : str
        ``ros2msg``, ``ros1msg``, ``ros2idl`` or empty.
    text : str
        Schema text with all nested types, as logs carry it. When it is empty (rosbag2 records
        such schemas when the .msg files were missing) the standard types are looked up by name.
    encoding : {'cdr', 'ros1'}
        How messages of the topic are serialised.

    Raises
    ------
    DefinitionError
        The text cannot be parsed, or the type is neither in it nor a standard one.
    """
    name = normalise_type_name(type_name)
    if text.strip() and schema_encoding not in SCHEMA_ENCODINGS:
        raise DefinitionError(f"unsupported schema encoding '{schema_encoding}'")
    if len(text) > MAX_SCHEMA:
        raise DefinitionError(f"schema of {type_name} has {len(text)} characters")
    ready = _standard_fields(name, text, encoding)
    if ready is not None:
        return Definition(name, encoding, ready)
    return definition_of(type_name, schema_encoding, text, encoding)


def definition_of(type_name: str, schema_encoding: str, text: str, encoding: str) -> Definition:
    """A definition as rosbags parses it, be the type a standard one or not."""
    name = normalise_type_name(type_name)
    parsed = _parsed(type_name, schema_encoding, text)
    if name not in parsed:
        parsed = _standard_types(encoding) | parsed
    if name not in parsed:
        raise DefinitionError(
            f"the log has no definition of {type_name} and it is not a standard type"
        )
    types: dict[str, tuple[tuple[str, FieldType], ...]] = {}
    _collect(name, parsed, types, encoding)
    _refuse_recursion(name, types, (), set())
    return Definition(name, encoding, types)


def _standard_fields(
    name: str, text: str, encoding: str
) -> dict[str, tuple[tuple[str, FieldType], ...]] | None:
    """Fields of a standard type and all it nests, if a schema is that of one, or empty."""
    of_types = _standard_file()[encoding]
    if name not in of_types or (text.strip() and _plain(text) != _plain(of_types[name][0])):
        return None
    fields = _standard_file()["fields"][encoding]
    return {
        each: tuple((field, FieldType(*ftype)) for field, *ftype in fields[each])
        for each in of_types[name][2]
    }


def _plain(text: str) -> tuple[str, frozenset[str]]:
    """A schema without remarks and blanks: the type itself, and those that it nests in any order.

    What is no remark, but a text with a # in it, makes it unlike any standard type.
    """
    lines = (" ".join(line.partition("#")[0].split()) for line in text.split("\n"))
    plain = "\n".join(line.replace(" =", "=").replace("= ", "=") for line in lines if line)
    first, *others = plain.split("=" * 80)
    return first.strip(), frozenset(other.strip() for other in others)


def _parsed(type_name: str, schema_encoding: str, text: str) -> dict[str, Any]:
    """Types of a schema, as rosbags parses it."""
    if not text.strip():
        return {}
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    # The grammar knows neither \r\n nor blanks at the end of a line; recorders write both.
    lines = [line.rstrip() for line in text.split("\n")]
    try:
        if schema_encoding == "ros2idl":
            # All files in one text: what holds them together is no part of the grammar
            seams = ("#include", "=" * 80, "IDL: ")
            lines = [line for line in lines if not line.lstrip().startswith(seams)]
            return dict(get_types_from_idl("\n".join(lines)))
        return dict(get_types_from_msg("\n".join(lines), normalise_type_name(type_name)))
    except Exception as exc:  # rosbags' parser raises classes of its own and others'
        reason = " ".join(str(exc).split())[:120]
        raise DefinitionError(f"schema of {type_name} cannot be parsed ({reason})") from exc


def schema_text(type_name: str, encoding: str) -> str:
    """Full concatenated schema text of a standard type (``ros2msg`` or ``ros1msg``).

    Parameters
    ----------
    type_name : str
        A standard type in ROS 2 spelling.
    encoding : {'cdr', 'ros1'}
        Which flavour: ROS 1 headers have a sequence number.

    Raises
    ------
    DefinitionError
        It is not a standard type.
    """
    return _standard(type_name, encoding)[0]


def type_hash(type_name: str) -> str:
    """RIHS01 hash (ROS 2) of a standard type."""
    return _standard(type_name, "cdr")[1]


def md5_sum(type_name: str) -> str:
    """MD5 (ROS 1) of a standard type's definition."""
    return _standard(type_name, "ros1")[1]


def _standard(type_name: str, encoding: str) -> tuple[str, str]:
    """Schema text and hash of a standard type.

    Those of the usual types lie beside this module.
    """
    usual = _standard_file()[encoding].get(type_name)
    return (usual[0], usual[1]) if usual else collected(type_name, encoding)


def collected(type_name: str, encoding: str) -> tuple[str, str]:
    """Schema text and hash of a standard type out of rosbags' collection."""
    from rosbags.typesys import TypesysError

    store = _store(encoding)
    try:
        text, md5 = store.generate_msgdef(type_name, ros_version=1 if encoding == "ros1" else 2)
        return text, str(md5 if encoding == "ros1" else store.hash_rihs01(type_name))
    except (KeyError, TypesysError) as exc:
        raise DefinitionError(f"{type_name} is not a standard type") from exc


@lru_cache(maxsize=1)
def _standard_file() -> dict[str, dict[str, Any]]:
    content = pkgutil.get_data(__name__, "standard.json")
    assert content is not None
    return dict(json.loads(content))


@lru_cache(maxsize=2)
def _store(encoding: str) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if encoding != "ros1":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    # rosbags' collection for ROS 1 has no tf2_msgs
    tf = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(tf, "tf2_msgs/msg/TFMessage"))
    return store


def _standard_types(encoding: str) -> dict[str, Any]:
    return dict(_store(encoding).fielddefs)


def _collect(
    name: str,
    parsed: dict[str, Any],
    types: dict[str, tuple[tuple[str, FieldType], ...]],
    encoding: str,
    depth: int = 0,
) -> None:
    """Copy a type and all it nests from rosbags' form into ours."""
    if name in types:
        return
    if depth > MAX_CHAIN:
        raise DefinitionError(f"its types nest more than {MAX_CHAIN} deep")
    if name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
        # ROS 1 has these as primitives and no schema spells them out.
        second = "uint32" if encoding == "ros1" and name.endswith("Time") else "int32"
        fraction = "int32" if encoding == "ros1" and name.endswith("Duration") else "uint32"
        types[name] = (("sec", FieldType("base", second)), ("nanosec", FieldType("base", fraction)))
        return
    if name not in parsed:
        standard = _standard_types(encoding)
        if name not in standard:
            raise DefinitionError(f"type {name} is not defined in the schema")
        parsed = parsed | {name: standard[name]}
    fields = [
        (field, _field_type(descriptor))
        for field, descriptor in parsed[name][1]
        # rosbags' placeholder for empty types: on the wire in CDR only
        if encoding == "cdr" or field != "structure_needs_at_least_one_member"
    ]
    types[name] = tuple(fields)
    for _, ftype in fields:
        if ftype.kind == "message" or ftype.element == "message":
            _collect(ftype.name, parsed, types, encoding, depth + 1)


def _refuse_recursion(
    name: str,
    types: dict[str, tuple[tuple[str, FieldType], ...]],
    above: tuple[str, ...],
    sound: set[str],
) -> None:
    """A type inside itself has no layout, and no depth at which a walk would end."""
    if name in above:
        raise DefinitionError(f"type {name} contains itself")
    if len(above) > MAX_DEPTH:
        raise DefinitionError(f"type {above[0]} nests {len(above)} deep")
    if name in sound:
        return
    for _, ftype in types[name]:
        if ftype.kind == "message" or ftype.element == "message":
            _refuse_recursion(ftype.name, types, (*above, name), sound)
    sound.add(name)


def _field_type(descriptor: Any) -> FieldType:
    from rosbags.interfaces import Nodetype

    node, value = descriptor
    if node == Nodetype.BASE:
        return FieldType("base", value[0])
    if node == Nodetype.NAME:
        return FieldType("message", value)
    (subnode, subvalue), count = value
    element = "base" if subnode == Nodetype.BASE else "message"
    name = subvalue[0] if subnode == Nodetype.BASE else subvalue
    if node == Nodetype.ARRAY:
        return FieldType("array", name, element, count)
    return FieldType("sequence", name, element)
