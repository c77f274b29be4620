"""Units of angle and acceleration."""

from __future__ import annotations

import math

DEGREE = math.pi / 180.0
"""rad."""

ARCSEC = DEGREE / 3600.0
"""rad."""

DEGREE_PER_HOUR = DEGREE / 3600.0
"""rad/s."""

DEGREE_PER_ROOT_HOUR = DEGREE / 60.0
"""Of a random walk of angle, rad/sqrt(s)."""

STANDARD_GRAVITY = 9.80665
"""m/s^2; ISO 2533:1975."""

MILLI_G = 1e-3 * STANDARD_GRAVITY
"""m/s^2."""

MICRO_G = 1e-6 * STANDARD_GRAVITY
"""m/s^2."""
