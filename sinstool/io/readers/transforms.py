"""Who is whose parent in a log's transform tree."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice

from sinstool.core.errors import UnsupportedLogError
from sinstool.io.messages.layout import Layout
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import layouts

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
    channels = []
    for channel in log.channels.values():
        if channel.type in TF_TYPES:
            with suppress(UnsupportedLogError):
                channel.definition(log.path)
                channels.append(channel)
    if channels:
        for layout, payload in islice(layouts(log, channels), MAX_MESSAGES):
            parent = _parent(layout, payload, child)
            if parent is not None:
                return parent
    return None


def _parent(layout: Layout, payload: bytes, child: str) -> str | None:
    index = 0
    while f"transforms[{index}].child_frame_id" in layout.leaves:
        name = layout.text(f"transforms[{index}].child_frame_id", payload)
        if name.lstrip("/") == child.lstrip("/"):
            return layout.text(f"transforms[{index}].header.frame_id", payload)
        index += 1
    return None
