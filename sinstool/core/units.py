"""Units of degrees and gravity, once."""

from __future__ import annotations

import numpy as np

DEGREE = np.pi / 180.0


STANDARD_GRAVITY = 9.80665
