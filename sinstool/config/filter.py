"""The INS/GNSS filter and its smoother."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from sinstool.config.group import Group


class FilterOptions(Group):
    """The INS/GNSS filter and its smoother."""

    filter: Literal["network-26a", "network-26", "baro-24", "plain-15"] = Field(
        "network-26a",
        description="network-26a: damped height, its network's states and what it corrects in the"
        " filter; network-26: the published 26 states; baro-24: undamped, the barometer a"
        " measurement; plain-15: no states for correlated GNSS errors",
    )
    feedback: Literal["closed", "none"] = Field(
        "closed", description="whether the filter corrects the navigation and the sensors"
    )
    virtual_noise: Literal["on", "off"] = Field(
        "on", description="fictitious process noise, against errors of the model"
    )
    adaptive: Literal["off", "sage-husa", "innovation"] = Field(
        "off", description="measurement noise from the innovations"
    )
    schmidt_epsilon: float = Field(
        0.0, ge=0, le=1, description="weight of the newest measurement beyond its due"
    )
    restart_after: int = Field(
        60, ge=1, description="epochs in a row that the gate rejects before the filter begins anew"
    )
    smooth: bool = Field(False, description="smooth over the whole log (Rauch, Tung, Striebel)")
    withhold_gnss: tuple[str, ...] = Field(
        (),
        description="START:END in seconds from the log's start: fixes there are scored, not used;"
        " repeatable",
    )
    gnss_sigma: float | None = Field(
        None,
        gt=0,
        description="position noise in m per horizontal axis where the log gives none (default:"
        " 5; vertical is 1.6 times that)",
    )
    gnss_noise_scale: float = Field(
        1.0, gt=0, description="factor on what receivers say of their own noise"
    )

    baro_sigma: float | None = Field(
        None,
        gt=0,
        description="what the barometer is off by for minutes, in m (default: 10)",
    )
    gnss_velocity_lag: float | None = Field(
        None,
        ge=-1,
        le=1,
        description="seconds by which a receiver stamps velocities later than positions (default:"
        " found from the fixes); --gnss-latency is then the mean of both",
    )

    @field_validator("withhold_gnss")
    @classmethod
    def _spans(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for text in value:
            span(text)
        return value


def span(text: str) -> tuple[float, float]:
    """START:END as two numbers of seconds.

    Raises
    ------
    ValueError
        The text is none.
    """
    start, separator, end = text.partition(":")
    try:
        begin, stop = float(start), float(end)
    except ValueError:
        separator = ""
        begin = stop = 0.0
    if not separator or not begin < stop:
        raise ValueError(f"'{text}' is not START:END in seconds")
    return begin, stop
