"""Where the checkout lies, and how its program is started."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = (sys.executable, "-c", "from sinstool.cli.main import main; main()")
