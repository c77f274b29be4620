"""Truth trajectories with exact inertial samples, and the errors of sensors."""

from sinstool.core.compiled import set_up_cache

set_up_cache()
