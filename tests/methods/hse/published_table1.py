"""Table 1 of Yu et al., J. NUDT 35(4), 2013, p. 164: headings at four azimuths, three each.

Arc seconds. In print the table has fallen apart: the azimuths stand at odd rows and the last
row of the last column is empty. Three consecutive rows belong to one azimuth: each column sums
to zero, and the compensation (before less after) has one sign within each three. The missing
figure, the peak-to-peak value after compensation, follows from the column.
"""

import numpy as np

AZIMUTH_DEG = np.repeat([0.0, 91.8795, 181.2953, 272.8711], 3)
POSITION = np.repeat(np.arange(4), 3)
BEFORE = np.array(
    [5.16, -19.54, -15.54, 12.26, 6.16, 13.36, -0.54, 20.96, -1.24, -8.44, -2.94, -9.64]
)
AFTER = np.array([5.38, -13.92, -10.12, 0.88, -1.62, 6.88, -4.62, 14.58, -3.52, 0.08, 5.08, 0.88])
PRINTED_PEAK_TO_PEAK_BEFORE = 40.50
