"""Who is whose parent in a log's transform tree."""

from __future__ import annotations

from sinstool.core.errors import UnsupportedLogError
from sinstool.io.messages.definitions import Definition
from sinstool.io.messages.layout import Layout, LayoutError, walk
from sinstool.io.readers.log import Log

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# The tree of a vehicle is complete within its first messages; reading on would cost a Python
# call for each of what may be millions.
MAX_MESSAGES = 20_000


def tf_parent(log: Log, child: str) -> str | None:
    """Parent of a frame in the log's own /tf and /tf_static; None where it has none.

    Parameters
    ----------
    child : str
        Frame id.

    Returns
    -------
    str or None
    """
    channels = {c.id: c for c in log.channels.values() if c.type in TF_TYPES}
    if not channels:
        return None
    definitions: dict[int, Definition] = {}
    for number, channel in channels.items():
        try:
            definitions[number] = channel.definition(log.path)
        except UnsupportedLogError:
            continue
    seen = 0
    for batch in log.batches(list(definitions)):
        for i in range(len(batch)):
            start = int(batch.offset[i])
            payload = batch.buffer[start : start + int(batch.length[i])].tobytes()
            try:
                layout = walk(definitions[int(batch.channel[i])], payload)
            except LayoutError:
                continue
            parent = _parent(layout, payload, child)
            if parent is not None:
                return parent
            seen += 1
        if seen >= MAX_MESSAGES:
            break
    return None


def _parent(layout: Layout, payload: bytes, child: str) -> str | None:
    index = 0
    while f"transforms[{index}].child_frame_id" in layout.leaves:
        name = layout.text(f"transforms[{index}].child_frame_id", payload)
        if name.lstrip("/") == child.lstrip("/"):
            return layout.text(f"transforms[{index}].header.frame_id", payload)
        index += 1
    return None
