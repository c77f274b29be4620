"""Values of options that the shell offers; where finding them fails, it offers none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from sinstool.config.logs import EMITS
from sinstool.core.errors import one_line
from sinstool.io.readers import message_types
from sinstool.methods.coning.registry import names

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]

# Types of the messages that an option's topic may have
TOPIC_TYPES = {
    "imu_topic": (message_types.IMU_TYPE,),
    "gnss_topic": message_types.FIX_TYPES,
    "velocity_topic": (*message_types.VELOCITY_TYPES, *message_types.GPS_FIX_TYPES),
    "wheels": (message_types.JOINT_TYPE, *message_types.VELOCITY_TYPES),
    "baro_topic": (message_types.PRESSURE_TYPE, *message_types.HEIGHT_TYPES),
    "magnetometer": (message_types.MAGNETIC_TYPE,),
    "encoder_topic": (message_types.JOINT_TYPE,),
}
# The word that leaves a topic out (as in io.readers.topics, which is slow to import), and the
# options that accept it
NONE = "none"
OPTIONAL_TOPICS = ("gnss_topic", "velocity_topic", "wheels", "baro_topic", "magnetometer")
FILES = ("hse", "imu_noise", "report", "gyro_response")


def completion(name: str) -> Complete | None:
    """Completion of an option's value where its type offers none.

    Parameters
    ----------
    name : str
        Name of the option's field.
    """
    if name in ("coning", "reference"):
        return lambda _, __, begun: [CompletionItem(n) for n in names() if n.startswith(begun)]
    if name == "algorithms":
        return word_list(*names())
    if name == "emit":
        return word_list(*EMITS)
    if name in TOPIC_TYPES:
        return _topics(TOPIC_TYPES[name], (NONE,) if name in OPTIONAL_TOPICS else ())
    # The shell completes names of files by itself.
    return (lambda _, __, begun: [CompletionItem(begun, type="file")]) if name in FILES else None


def word_list(*words: str) -> Complete:
    """Completion of a comma-separated list: the words before the last comma stay."""

    def complete(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
        head, comma, last = begun.rpartition(",")
        return [
            CompletionItem(f"{head}{comma}{word}")
            for word in words
            if word.startswith(last) and word not in head.split(",")
        ]

    return complete


def _topics(types: tuple[str, ...], words: tuple[str, ...]) -> Complete:
    """Completion of a topic: those of the log that was typed already, and some words."""

    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
        typed = context.params.get("log") or context.params.get("logs") or ()
        logs = typed if isinstance(typed, tuple) else (typed,)
        # Where an option still lacks its value, click stops parsing before it reaches LOG.
        paths = [path for word in (*logs, *context.args) if (path := Path(word)).is_file()]
        try:
            offered = topics(paths[0], types) if paths else []
        except Exception:  # a log that cannot be read: the command itself will say so
            offered = []
        return [CompletionItem(word) for word in (*offered, *words) if word.startswith(begun)]

    return complete


def topics(log: Path, types: tuple[str, ...]) -> list[str]:
    """Topics of the given types in the summary of an MCAP; none for other logs, slow to search.

    Parameters
    ----------
    log : Path
        A file of any format.
    types : tuple of str
        Names of message types as in ROS 2.

    Returns
    -------
    list of str
        Sorted by name.
    """
    from mcap.reader import make_reader

    from sinstool.io.messages.definitions import normalise_type_name
    from sinstool.io.readers.formats import kind_of

    with log.open("rb") as stream:
        if kind_of(stream)[0] != "mcap":
            return []
        stream.seek(0)
        summary = make_reader(stream).get_summary()
    if summary is None:
        return []
    kinds = {key: schema.name for key, schema in summary.schemas.items()}
    return sorted(
        {
            one_line(channel.topic)
            for channel in summary.channels.values()
            if normalise_type_name(kinds.get(channel.schema_id, "")) in types
        }
    )
