"""Conventions that hold in every module, and are stated only here.

Frames
    ``i`` inertial, ``e`` Earth (WGS-84), ``n`` navigation = North-East-Down (NED),
    ``b`` body = Forward-Right-Down (FRD). ``C_nb`` and ``q_nb`` take a vector from ``b``
    to ``n``: ``v_n = C_nb @ v_b``. A vector has its frame as a suffix and the frames
    that it relates as subscripts: ``omega_ib_b`` is the rate of ``b`` against ``i``, in ``b``.

    Logs follow REP-103 (body Forward-Left-Up, world East-North-Up). The code that reads
    streams and the code that writes solutions convert them; no other code does.
    If nothing in a log references heading to north, heading starts at 0 and the attitude is
    in the frame ``odom``; a north-referenced attitude is in ``map``.

Quaternions
    Hamilton, unit, scalar first ``[w, x, y, z]``. ROS messages are scalar last
    and are converted on reading and writing. ``q_nb`` composes on the right with body rotations:
    ``q_nb(k+1) = q_nb(k) * exp(rotation_vector)``.

Angles
    Roll, pitch, heading are the 3-2-1 Euler angles of FRD in NED: heading positive from
    North to East, pitch positive nose up, roll positive right wing down.

Gravity
    An accelerometer measures specific force, acceleration less gravity: at rest 9.8 m/s^2 upward,
    so +9.8 on z of a Forward-Left-Up log and -9.8 on z of a Forward-Right-Down one. Logs whose
    driver has removed gravity are good for attitude only.

Units
    SI and radians internally. Degrees, deg/h and arc seconds appear only on the command line
    and in reports, where the unit is part of the name.

Height
    Ellipsoidal, metres, positive up. The ``down`` of NED is negative height change.

Time
    ``int64`` nanoseconds throughout. Seconds as ``float64`` appear only
    as differences of two times.

Samples
    ``increment``: sample k is the integral of angular rate (or specific force) over
    (t[k-1], t[k]]. ``mean-rate``: that integral divided by the interval. ``rate``: the
    value at the instant t[k]. They are not interchangeable. The attitude at t[k] is that at
    the end of the interval.
"""
