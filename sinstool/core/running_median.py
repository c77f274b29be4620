"""Running medians."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

# Windows handled at a time, to bound memory
AT_ONCE = 4096


def running_median(values: np.ndarray, wide: int) -> np.ndarray:
    """Running medians along the first axis; beyond both ends the rows are mirrored.

    `scipy.ndimage` does the same, but takes longer to import than most logs to process.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
    wide : int
        Rows in a window. For an even number, the larger of the two middle values is taken.

    Returns
    -------
    ndarray, shape (n, ...)
    """
    before = wide // 2
    ends = ((before, wide - 1 - before), *[(0, 0)] * (values.ndim - 1))
    windows = sliding_window_view(np.pad(values, ends, "symmetric"), wide, axis=0)
    blocks = [windows[k : k + AT_ONCE] for k in range(0, len(windows), AT_ONCE)]
    return np.concatenate([np.partition(block, before, axis=-1)[..., before] for block in blocks])
