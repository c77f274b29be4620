"""The INS/GNSS filter and its smoother."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from sinstool.core.options import Group, option, span


class FilterOptions(Group):
    """The INS/GNSS filter and its smoother."""

    filter: Literal["network-26a", "network-26", "baro-24", "plain-15"] = option(
        "network-26a",
        "network-26a: damped height, its network's states and what it corrects in the"
        " filter; network-26: the published 26 states; baro-24: undamped, the barometer a"
        " measurement; plain-15: no states for correlated GNSS errors",
    )
    feedback: Literal["closed", "none"] = option(
        "closed", "whether the filter corrects the navigation and the sensors"
    )
    virtual_noise: Literal["on", "off"] = option(
        "on", "fictitious process noise, against errors of the model"
    )
    adaptive: Literal["off", "sage-husa", "innovation"] = option(
        "off", "measurement noise from the innovations"
    )
    schmidt_epsilon: float = option(
        0.0, "weight of the newest measurement beyond its due", "X", ge=0, le=1
    )
    restart_after: int = option(
        60, "epochs in a row that the gate rejects before the filter begins anew", "N", ge=1
    )
    smooth: bool = option(False, "smooth over the whole log (Rauch, Tung, Striebel)")
    withhold_gnss: tuple[str, ...] = option(
        (),
        "START:END in seconds from the log's start: fixes there are scored, not used; repeatable",
        "START:END",
    )
    gnss_sigma: float | None = option(
        None,
        "position noise in m per horizontal axis where the log gives none (default:"
        " 5; vertical is 1.6 times that)",
        "M",
        gt=0,
    )
    gnss_noise_scale: float = option(
        1.0, "factor on what receivers say of their own noise", "X", gt=0
    )

    baro_sigma: float | None = option(
        None, "what the barometer is off by for minutes, in m (default: 10)", gt=0
    )
    gnss_velocity_lag: float | None = option(
        None,
        "seconds by which a receiver stamps velocities later than positions (default:"
        " found from the fixes); --gnss-latency is then the mean of both",
        ge=-1,
        le=1,
    )

    @field_validator("withhold_gnss")
    @classmethod
    def _spans(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for text in value:
            span(text)
        return value
