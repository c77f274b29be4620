"""Where the antenna of the fixes is, by the static transforms of a log."""

from __future__ import annotations

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.io.readers.frames import turn_body
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import FIX_TYPES
from sinstool.io.readers.streams import frame_id
from sinstool.io.readers.transforms import position_in
from sinstool.survey.needs import may_need_antenna

# Transforms that nobody filled in have everything at one place, and no antenna is further away, m.
LEAST_ARM_M, LONGEST_ARM_M = 1e-3, 100.0


def antenna_b(
    log: Log, config: ProcessConfig, body: str, fix_topic: str
) -> tuple[float, float, float] | None:
    """From the IMU to the antenna, FRD, m; None where transforms do not say it, or options do.

    Parameters
    ----------
    body : str
        Frame id of the IMU.
    fix_topic : str
        Topic of the fixes, whose frame is that of the antenna; '' without one.
    """
    if not fix_topic or not may_need_antenna(config):
        return None
    antenna = frame_id(log, log.channels_of(fix_topic, *FIX_TYPES))
    arm = position_in(log, antenna, body) if antenna else None
    if arm is None or not LEAST_ARM_M < np.linalg.norm(arm) < LONGEST_ARM_M:
        return None
    x, y, z = turn_body(arm, config.input.body_axes).tolist()
    return x, y, z


def with_antenna(config: ProcessConfig, arm_b: tuple[float, float, float] | None) -> ProcessConfig:
    """The configuration with this lever arm, FRD, m; None for the one that it has."""
    if arm_b is None:
        return config
    gnss = config.gnss.model_copy(update={"lever_arm": arm_b})
    return config.model_copy(update={"gnss": gnss})
