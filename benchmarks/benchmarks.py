"""What `import benchmarks` finds in a program started as `python benchmarks/x.py`: the package.

Python looks for modules beside such a program, not in the checkout, where `benchmarks` and `tests`
are packages. This puts the checkout in the place of the program's folder, and the package in the
place of this module.
"""

import sys
from importlib import import_module
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])
del sys.modules["benchmarks"]
import_module("benchmarks")
