"""Heading-sensitive error of a system on a turntable that turns at a constant rate.

Three gyros stand askew on a table that turns about a nearly vertical axis, so that each of them
sees a large rate and none locks in. The heading found from them at rest has an error that grows
with the table's rate and with the lean of its axis towards the East: the heading-sensitive
error (HSE). One coefficient, lambda2, describes it, and can be measured without any reference.

In the order of processing: :mod:`~sinstool.methods.hse.rig` describes the rig,
:mod:`~sinstool.methods.hse.encoder` gives the table's angle at the edges of the gyro intervals,
:mod:`~sinstool.methods.hse.segments` finds where the table turns steadily and sums each
whole turn, :mod:`~sinstool.methods.hse.whole_turn` computes heading, tilt and axial rate error
from these sums, and :mod:`~sinstool.methods.hse.fit` estimates the coefficient from many runs.

The error of the calibration is one matrix in ``b``, ``X = C~_s^b K~_g K_g^-1 C_b^s - I``, where
tildes mark the matrices of the user. Averaged over whole turns at a constant rate only three
numbers of it remain, ``a = (X11 + X22)/2``, ``c = X33`` and ``d = (X21 - X12)/2``:

    mean(Rz X Rz^T) = [[a, -d, 0], [d, a, 0], [0, 0, c]],

which is exact. Of these only ``c`` multiplies the rate Omega of the table, and
``lambda2 = -3 c``. To first order the heading error is ``lambda1 lambda2 C23 / (3 w_ie cos L)``
with ``lambda1 = Omega - w_ie sin L`` and the east component C23 of the axis; eqs. (14) to (16) of
the paper below.

Frames, besides those of :mod:`sinstool.core.conventions`
    ``b`` body: z along the table's axis, downward; turns with the table.
    ``b0`` base: equal to ``b`` when the encoder angle is 0; ``C_b0b = Rz(alpha)``, so alpha grows
    clockwise seen from above.
    ``s`` sensor: orthogonal; x along the x gyro, y in the plane of the x and y gyros.
    ``g`` the raw, skewed triad of gyros: ``omega_s = K_g omega_g``.

References
----------
H. Yu, W. Wu, J. Cao, B. Zhao, W. Liu, "On-line calibration and compensation of heading-sensitive
error for triad constant-rate biased RLG system", Journal of National University of Defense
Technology 35(4), 2013, 161-165.
"""
