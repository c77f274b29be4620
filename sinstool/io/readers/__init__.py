"""Recorded logs as columns, in bounded memory: MCAP, ROS 1 bags, ROS 2 bags and ULog.

`open_log` recognises formats by content. A `Log` gives raw messages in batches, which `streams`
turns into the columns of `sinstool.core.streams`.
"""

from sinstool.io.readers.open import open_log

__all__ = ["open_log"]
