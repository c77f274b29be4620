import os
import subprocess
import sys

CODE = """
import sys
import numba
import numpy as np
from sinstool.core.compiled import load_quickly
load_quickly()
from sinstool.core.quaternion_kernels import cross
assert cross(1.0, 0.0, 0.0, 0.0, 2.0, 0.0) == (0.0, 0.0, 2.0)
print("numba.np.linalg" in sys.modules)

@numba.njit
def length(x):
    return np.linalg.norm(np.array(cross(x, 0.0, 0.0, 0.0, x, 0.0)))

print(length(3.0))
"""


def test_what_is_compiled_is_loaded_without_the_compiler_and_the_rest_is_compiled(tmp_path):
    outputs = [
        subprocess.run(
            [sys.executable, "-c", CODE],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for _ in range(2)
    ]
    assert outputs == [["True", "9.0"], ["False", "9.0"]]
