"""Recorded logs as columns, in bounded memory: MCAP, ROS 1 bags and ROS 2 bags.

`open_log` tells formats by content. A `Log` gives raw messages in batches; `streams` turns
them into the columns of `sinstool.core.streams`.
"""

from sinstool.io.readers.open import open_log

__all__ = ["open_log"]
