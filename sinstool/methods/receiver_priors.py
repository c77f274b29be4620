"""Priors of a receiver's latency and of the place of its antenna, before a log shows them."""

LATENCY_S = 0.2
"""Standard deviation of a latency about 0, s."""

ARM_GIVEN_M = 0.1
"""Standard deviation of a lever arm that is given, m: it is measured to a decimetre."""

ARM_USUAL_M = 1.0
"""Distance of an antenna from the IMU along an axis that the log does not show, 1 sigma, m."""

ARM_UNKNOWN_M = 2.0
"""Prior of a lever arm that is estimated, along each axis about 0, 1 sigma, m: wider than usual, so
that it hardly pulls the estimate."""
