"""The conformance set as @mcap/core writes it, and as the readers' own tests build it."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.io.readers.conformance import built, variants

pytestmark = pytest.mark.slow


def test_the_set_is_byte_for_byte_what_mcap_core_writes(npm_packages, tmp_path):
    script = shutil.copy(Path(__file__).with_name("conformance.mjs"), npm_packages)
    every = list(variants())
    done = subprocess.run(
        ["node", "--single-threaded", script, tmp_path],
        input=json.dumps(every),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.iterdir())) == len(every) == 416
    for variant in every:
        theirs = (tmp_path / f"{variant['name']}.mcap").read_bytes()
        assert built(variant["features"], variant["records"]) == theirs, variant["name"]
