"""Runs without noise by brute force, and runs with noise by the linear model."""

from dataclasses import replace

import numpy as np

from sinstool.methods.hse.run import HseRun

W = 7.292115e-5
ARCSEC = np.pi / 180.0 / 3600.0
EPSILON = np.array([2.2, 0.8, 1.2]) * ARCSEC
RATES = np.radians([20.0, 40.0, 60.0])


def rz(a):
    return np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])


def attitude(psi, theta, gamma):
    """C_b0^n by three rotations."""
    ct, st, cg, sg = np.cos(theta), np.sin(theta), np.cos(gamma), np.sin(gamma)
    ry = np.array([[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]])
    rx = np.array([[1.0, 0.0, 0.0], [0.0, cg, -sg], [0.0, sg, cg]])
    return rz(psi) @ ry @ rx


def brute_run(
    rate, psi, theta, gamma, epsilon=EPSILON, latitude=0.49, delay=0.0, number=0, **fields
):
    """A run of the rig, rates resolved at 48 angles of a turn and averaged as a user would.

    Yu et al. 2013, eqs. (5) and (6), evaluated; heading from the mean rate and the vertical.
    """
    C = attitude(psi, theta, gamma)
    w_n = W * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    e = -np.ones(3) / np.sqrt(3.0)
    y = np.cross(e, [1.0, 0.0, 0.0])
    y /= np.linalg.norm(y)
    C_sb = np.stack([np.cross(y, e), y, e])
    error = np.array([[0, 0, 0], [epsilon[0], 0, 0], [epsilon[1], epsilon[2], 0]], dtype=float)
    mean = np.zeros(3)
    for alpha in np.arange(48) * 2.0 * np.pi / 48:
        rate_b = rz(alpha).T @ C.T @ w_n + [0.0, 0.0, rate]
        result = C_sb @ (np.eye(3) + error) @ C_sb.T @ rate_b
        mean += rz(alpha - rate * delay) @ result / 48
    mean -= [0.0, 0.0, rate]
    down = C[2]
    east = np.cross(down, mean)
    east /= np.linalg.norm(east)
    north = np.cross(east, down)
    along = C[:, 2] @ w_n
    run = HseRun(
        id=f"r{number}",
        source="a.mcap",
        t_start_s=600.0 * number,
        duration_s=594.0,
        n_turns=33,
        rate=float(rate),
        heading=float(np.arctan2(east[0], north[0]) % (2.0 * np.pi)),
        sigma_heading=19.0 * ARCSEC,
        theta=theta,
        gamma=gamma,
        C23=float(east[2]),
        sigma_C23=0.1 * ARCSEC,
        c_axial=float((mean[2] - along) / (rate + along)),
        sigma_c_axial=1.7e-8 * 0.349 / abs(rate),
        latitude=latitude,
    )
    return replace(run, **fields)


def brute_runs(rates=None, psi=0.7, lean=8e-4, first=0, **more):
    """Three repeats of each rate at one position where the axis leans east by ``lean``."""
    rates = np.tile(RATES, 3) if rates is None else rates
    theta, gamma = lean * np.sin(psi), -lean * np.cos(psi)
    return [
        brute_run(rate, psi, theta, gamma, number=first + i, **more) for i, rate in enumerate(rates)
    ]


def noisy(runs, rng, sigma=None):
    """The same with noise of their own sigma, or of the one given."""
    return [
        replace(
            r,
            heading=(r.heading + (sigma or r.sigma_heading) * rng.standard_normal()) % (2 * np.pi),
            c_axial=r.c_axial + r.sigma_c_axial * rng.standard_normal(),
        )
        for r in runs
    ]


def spread(runs, rng):
    """The same with sigmas from half to twice of theirs."""
    return [replace(r, sigma_heading=r.sigma_heading * rng.uniform(0.5, 2.0)) for r in runs]
