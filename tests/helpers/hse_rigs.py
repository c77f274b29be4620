"""Turntable logs and their rigs, made and used through the command line."""

import contextlib
import io
import json
import sys
import tomllib
from functools import cache
from unittest.mock import patch

import numpy as np
import tomli_w

from sinstool.cli import main as main_module

ARCSEC = np.pi / 648000.0
W = 7.292115e-5
# The paper's coefficient; with e1 - e2 + e3 = 0 no constant offset of heading comes with it.
WITHOUT_OFFSET = "1.1,2.1,1.0"
SHORT = ("--min-turns", "4", "--min-duration", "15")


def sinstool(*arguments):
    """Run a command in this process: status, stdout, stderr."""
    out, err = io.StringIO(), io.StringIO()
    status = None
    with (
        patch.object(sys, "argv", ["sinstool", *map(str, arguments)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main_module.main()
        except SystemExit as exc:
            status = exc.code
    assert "Traceback" not in err.getvalue()
    return status, out.getvalue(), err.getvalue()


def simulate(folder, name, **config):
    """A log and its rig; options of `simulate hse-rig` by their names."""
    options = {
        "rates": "20,40,60",
        "plateau": 80,
        "rate": 50,
        "encoder_rate": 50,
        "truth": False,
        **config,
    }
    truth = options.pop("truth")
    words = [w for k, v in options.items() for w in (f"--{k.replace('_', '-')}", v)]
    log, rig = folder / f"{name}.mcap", folder / f"{name}.toml"
    status, _, err = sinstool(
        "simulate", "hse-rig", "-o", log, "--rig-out", rig, *words,
        "--truth" if truth else "--no-truth",
    )  # fmt: skip
    assert status == 0, err
    return log, rig


def edited(rig, name, calibration=None, encoder=None, **keys):
    """The rig with other keys, None to take one out, as a file beside it."""
    options = tomllib.loads(rig.read_text())
    options["rig"] |= keys
    options["rig"]["encoder"] |= encoder or {}
    options["rig"] = {k: v for k, v in options["rig"].items() if v is not None}
    if calibration:
        options["calibration"] = calibration
    path = rig.with_name(f"{name}.toml")
    path.write_text(tomli_w.dumps(options))
    return path


def calibrate(logs, rig, output, *more):
    """Calibrate: status, calibration as written, summary, warnings."""
    status, out, err = sinstool(
        "calibrate-hse", *logs, "--config", rig, "-o", output, "--json", *SHORT, *more
    )
    summary = json.loads(out)
    assert json.loads(output.read_text()) == summary["calibration"]
    return status, summary["calibration"], summary, err


def arcsec(angle):
    return float(angle) / ARCSEC


def wrapped(angle):
    return (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi


@cache
def correction(rate, lambda2, C23, latitude):
    """Eq. (14) of Yu et al. 2013, written out again."""
    return (rate - W * np.sin(latitude)) * lambda2 * C23 / (3.0 * W * np.cos(latitude))
