"""What a run may need of a log besides its IMU, so that nothing else is read."""

from __future__ import annotations

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.errors import TopicError
from sinstool.io.readers.log import Log
from sinstool.io.readers.topics import NONE, fix_topics


def needs_all_gnss(log: Log, config: ProcessConfig) -> bool:
    """Whether a run may need all of GNSS, not only where the log begins."""
    mode, align = config.navigation.mode, config.align.align
    if mode in ("ins", "ins-gnss") or config.vertical.height_damping != "off":
        return True
    if align in IN_FLIGHT:
        return True
    return (mode == "auto" or align == "auto") and has_gnss(log, config.input)


def may_need_barometer(log: Log, config: ProcessConfig) -> bool:
    """Whether a run may use the log's barometer."""
    damping, mode = config.vertical.height_damping, config.navigation.mode
    if damping == "baro":
        return True
    if damping == "gnss" or config.filter.filter == "plain-15":
        return False
    return mode == "ins-gnss" or (mode == "auto" and has_gnss(log, config.input))


def may_need_magnetometer(config: ProcessConfig) -> bool:
    """Whether a run that needs no GNSS may use the log's magnetometer."""
    options = config.navigation
    return options.attitude != "inertial" and options.magnetometer != NONE


def may_write_tf(config: ProcessConfig) -> bool:
    """Whether a run may write transforms beside the log's own."""
    emit = config.output.emit
    if config.output.only_results:
        return False
    return config.navigation.mode != "attitude" if emit is None else "tf" in emit


def may_need_mount(config: ProcessConfig) -> bool:
    """Whether a run may constrain a land vehicle without a configured mount of the IMU."""
    return (
        config.navigation.mode in ("auto", "ins-gnss")
        and config.filter.vehicle != "none"
        and config.filter.mount is None
    )


def may_need_antenna(config: ProcessConfig) -> bool:
    """Whether a run may use fixes whose antenna is not configured to be anywhere."""
    return config.navigation.mode in ("auto", "ins-gnss") and config.gnss.lever_arm is None


def has_gnss(log: Log, options: InputOptions) -> bool:
    """Whether a log has a topic with fixes that may be used."""
    try:
        return bool(fix_topics(log, options.gnss_topic))
    except TopicError:
        return False
