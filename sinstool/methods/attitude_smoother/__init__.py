"""Attitude corrected by gravity: a smoother of gyro, accelerometer and rest.

A vehicle does not accelerate for ever: its velocity, or the position of a hand, is bounded. So the
specific force, turned into navigation axes by the gyros, is gravity and the derivative of a bounded
velocity. That is a linear measurement of the tilt, and a Kalman filter over epochs of 0.2 s,
smoothed backwards [1]_, makes the most of it. The error of attitude, velocity and position is the
right-invariant one of [2]_: with it nothing that is observed of the tilt ever tells the filter of a
heading, of which gravity says nothing.

What the smoother corrects is an attitude that was integrated already, with whichever coning
algorithm: its state is ``C``, a rotation in navigation axes, and the attitude is ``C`` times the
integrated one. Where tilt and bias at the start are not known the smoother is iterated [3]_.

References
----------
.. [1] H. Rauch, F. Tung, C. Striebel, "Maximum likelihood estimates of linear dynamic systems",
   AIAA J. 3(8), 1965, 1445-1450.
.. [2] A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE
   Trans. Automatic Control 62(4), 2017, 1797-1812.
.. [3] B. M. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM J. Optimization
   4(3), 1994, 626-636.
"""
