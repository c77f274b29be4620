"""INS/GNSS integration: the error-state Kalman filter, its smoother, its diagnosis.

states        the error states, their signs, and the filters that have some of them
settings      settings of a filter, noise of GNSS and barometer, where it starts
model         transition of the errors, from the motion; covariance and estimate with it
update        a measurement
gnss, baro    measurements by GNSS and barometer, and whether they are believed
instants      substeps, feedback, beginning anew
loop          the compiled loop over IMU updates
parameters    settings as numbers for the loop
filter        :class:`~sinstool.methods.ins_gnss.filter.InsGnssFilter`, block by block
results       what it answers with
layout        which number lies where

In short::

    run = InsGnssFilter(start, settings, with_baro=True, output=True, store=False)
    block = run.push(increments, gnss, withheld, baro_time_ns, baro_height)   # FilterBlock
    run.events, run.summary                                                   # so far
"""
