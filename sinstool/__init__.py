"""sinstool: recorded IMU logs in, corrected attitude out.

The conventions below hold in every module; nothing else states them again.

Frames
    ``i`` inertial, ``e`` Earth (WGS-84), ``n`` navigation = North-East-Down (NED),
    ``b`` body = Forward-Right-Down (FRD). ``C_nb`` and ``q_nb`` take a vector from ``b``
    to ``n``: ``v_n = C_nb @ v_b``. A vector carries its frame as a suffix and what it
    relates as subscripts: ``omega_ib_b`` is the rate of ``b`` against ``i``, in ``b``.

    Logs follow REP-103 (body Forward-Left-Up, world East-North-Up). They are turned at the
    door, by the code that reads streams and the code that writes solutions, never inside.
    A log without any reference for heading gets heading 0 at the start and its attitude is
    given in the frame ``odom``; a north-referenced attitude is given in ``map``.

Quaternions
    Hamilton, unit, scalar first ``[w, x, y, z]``. ROS messages are scalar last; the door
    turns them. ``q_nb`` composes on the right with body rotations:
    ``q_nb(k+1) = q_nb(k) * exp(rotation_vector)``.

Angles
    Roll, pitch, heading are the 3-2-1 Euler angles of FRD in NED: heading positive from
    North to East, pitch positive nose up, roll positive right wing down.

Gravity
    An accelerometer shows specific force, acceleration less gravity: at rest 9.8 m/s^2 upward,
    so +9.8 on z of a Forward-Left-Up log and -9.8 on z of a Forward-Right-Down one. Logs from
    which gravity has been taken out serve for attitude only.

Units
    SI and radians inside. Degrees, deg/h and arc seconds appear only at the command line
    and in reports, and there the unit is part of the name.

Height
    Ellipsoidal, metres, positive up. The ``down`` of NED is negative height change.

Time
    ``int64`` nanoseconds from the log to the last line. Seconds as ``float64`` appear only
    as differences of two times.

Samples
    ``increment``: sample k is the integral of angular rate (or specific force) over
    (t[k-1], t[k]]. ``mean-rate``: that integral divided by the interval. ``rate``: the
    value at the instant t[k]. They are different things; nothing here confuses them. An
    attitude at t[k] is that of the end of the interval.
"""

from sinstool.core.version import VERSION as __version__

__all__ = ["__version__"]
