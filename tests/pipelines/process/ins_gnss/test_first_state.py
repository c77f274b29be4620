"""What a filter starts from, in words."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.timeline import SECOND
from sinstool.pipelines.process.ins_gnss.first_state import _how


@pytest.mark.parametrize(("held_s", "text"), [(58, "back over 58 s"), (-5, "forward over 5 s")])
def test_which_way_an_attitude_was_carried(held_s, text):
    found = SimpleNamespace(
        method="svd", held_ns=held_s * SECOND, time_ns=0, bias_source="alignment"
    )
    said = _how(found, np.diag(np.deg2rad([0.1, 0.1, 0.4]) ** 2))
    assert f"carried {text};" in said and said.endswith("heading known to 0.4 deg")
