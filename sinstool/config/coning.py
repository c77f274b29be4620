"""From angular rate to rotation vectors."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import field_validator

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option
from sinstool.methods.coning.registry import algorithm, names


class ConingOptions(Group):
    """From angular rate to rotation vectors."""

    coning: str = option("previous-3", "algorithm: " + ", ".join(names()), "NAME")
    sp_variant: Literal["exact", "bvp", "truncated", "printed"] | None = option(
        None,
        "form of the singular-perturbation solution (default: truncated with a"
        " preset, exact with --epsilon)",
    )
    sp_preset: Literal["best", "paper", "auto"] | None = option(
        None,
        "best: epsilon = T/2, n = 2; paper: 2e-4 s, n = 0.001; auto: nulls the drift"
        " of the log's own coning below --passband (default: best)",
    )
    epsilon: float | None = option(
        None, "boundary layer in seconds, with --beta-gain or --beta", "S", ge=0
    )
    beta_gain: float | None = option(None, "n of the paper's eq. (14)", "N")
    beta: tuple[float, float, float] | None = option(
        None, "a constant beta in rad/s^2, in the log's axes", "X,Y,Z"
    )
    passband: float | None = option(
        None, "Hz, up to which coning is motion (gyro-tuned, --sp-preset auto)", "HZ", gt=0
    )
    stopband: float | None = option(
        None, "Hz, from which on coning is noise (gyro-tuned)", "HZ", gt=0
    )
    gyro_response: str | None = option(
        None,
        "of the gyro, for gyro-tuned: none, cheb:ORDER,RIPPLE_DB,HZ, butter:ORDER,HZ,"
        " or a file with lines of frequency and gain",
        "RESPONSE",
    )

    @field_validator("coning")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            algorithm(value)
        except ConfigurationError as exc:
            raise ValueError(str(exc)) from exc
        return value

    def algorithm_options(self) -> dict[str, Any]:
        """Options of the algorithm that have been set, by its own names."""
        values = self.model_dump(exclude={"coning"}, exclude_none=True)
        return {name.removeprefix("sp_"): value for name, value in values.items()}


def check_coning(group: ConingOptions) -> None:
    """Whether the options given are those of the algorithm chosen, and fit each other."""
    options = group.algorithm_options()
    if group.coning == "gyro-tuned":
        # The interval is the log's; any will do to see whether the rest is possible.
        top = max(group.passband or 0.0, group.stopband or 0.0)
        algorithm(group.coning, **options, interval=0.25 / top if top else 1e-3)
    elif group.coning == "singular-perturbation" and group.sp_preset == "auto":
        strange = sorted(set(options) - {"preset", "passband", "variant"})
        if strange or group.sp_variant not in (None, "truncated"):
            raise ConfigurationError(
                "--sp-preset auto chooses the variant, epsilon and n itself",
                "leave the other options of singular-perturbation out",
            )
        if group.passband is None:
            raise ConfigurationError(
                "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
            )
    elif options:
        try:
            algorithm(group.coning, **options)
        except ConfigurationError as exc:
            raise ConfigurationError(
                f"--coning is {group.coning}: {exc.message}", exc.hint
            ) from exc
