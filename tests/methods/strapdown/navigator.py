"""The kernel of `process --mode ins`, without height damping, block by block."""

from types import SimpleNamespace

import numpy as np

from sinstool.methods.height import layout
from sinstool.methods.strapdown.free_inertial import navigate
from sinstool.methods.strapdown.navigation import SIZE

NO_HEIGHTS = (np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int64))


class Navigator:
    """A state, and the updates that advance it."""

    def __init__(self, state, order=0):
        self.state = np.array(state, dtype=np.float64)
        self._order = order

    def push(self, phi, dv, dt):
        """States at the ends of the updates, by columns."""
        phi, dv, dt = (np.ascontiguousarray(a, dtype=np.float64) for a in (phi, dv, dt))
        out = np.empty((len(dt), SIZE + 2))
        _, ran_away = navigate(
            self.state,
            np.empty(SIZE),
            layout.new_state(),
            np.zeros(layout.PARAMETERS),
            layout.new_events(0),
            False,
            phi,
            dv,
            dt,
            np.cumsum(dt),
            *NO_HEIGHTS,
            0,
            self._order,
            False,
            out,
        )
        assert ran_away < 0
        return SimpleNamespace(
            rows=out[:, :SIZE],
            latitude=out[:, 0],
            longitude=out[:, 1],
            height=out[:, 2],
            velocity_n=out[:, 3:6],
            q_nb=out[:, 6:10],
        )
