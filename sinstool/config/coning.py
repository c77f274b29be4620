"""Options of the coning algorithm, and of the comparison of several."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from sinstool.config.logs import IMU_INPUT
from sinstool.config.unused import listed
from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option
from sinstool.methods.coning.registry import algorithm, names, options_of

DEFAULT_CONING = "previous-3"
# Options of `compare-coning`; those of [coning] tell motion from noise
COMPARISON_OPTIONS = (
    "comparison",
    "coning.passband",
    "coning.stopband",
    "coning.gyro_response",
    "coning.sp_preset",
    *IMU_INPUT,
)


def _exists(name: str) -> str:
    try:
        algorithm(name)
    except ConfigurationError as exc:
        raise ValueError(str(exc)) from exc
    return name


class ConingOptions(Group):
    """The algorithm that makes rotation vectors of gyro samples, and its options."""

    title = "Coning"

    coning: str = option(
        DEFAULT_CONING,
        "coning algorithm, one of " + ", ".join(names()),
        "NAME",
        brief="coning algorithm (default: previous-3)",
    )
    sp_variant: Literal["exact", "bvp", "truncated", "printed"] | None = option(
        None,
        "form of the singular-perturbation solution (default: truncated with --sp-preset, exact"
        " with --epsilon)",
    )
    sp_preset: Literal["best", "paper", "auto"] | None = option(
        None,
        "best: epsilon = T/2, n = 2; paper: epsilon = 2e-4 s, n = 0.001; auto: chosen to null the"
        " drift from the log's own coning below --passband (default: best)",
    )
    epsilon: float | None = option(
        None, "boundary layer in s, with --beta-gain or --beta", "S", ge=0
    )
    beta_gain: float | None = option(None, "n of the paper's eq. (14)", "N")
    beta: tuple[float, float, float] | None = option(
        None, "constant beta in rad/s^2, in the log's axes", "X,Y,Z"
    )
    passband: float | None = option(
        None,
        "highest frequency of real coning, Hz (for gyro-tuned and --sp-preset auto)",
        "HZ",
        gt=0,
    )
    stopband: float | None = option(
        None, "lowest frequency at which coning is noise, Hz (for gyro-tuned)", "HZ", gt=0
    )
    gyro_response: str | None = option(
        None,
        "the gyro's own low-pass response, for gyro-tuned: none, cheb:ORDER,RIPPLE_DB,HZ,"
        " butter:ORDER,HZ, or a file with lines of frequency and gain",
        "RESPONSE",
    )

    @field_validator("coning")
    @classmethod
    def _exists(cls, name: str) -> str:
        return _exists(name)

    def algorithm_options(self) -> dict[str, Any]:
        """Options of the algorithm that have been set, by its own names."""
        values = self.model_dump(exclude={"coning"}, exclude_none=True)
        return {name.removeprefix("sp_"): value for name, value in values.items()}


def _require_passband(coning: ConingOptions) -> None:
    if coning.sp_preset == "auto" and coning.passband is None:
        raise ConfigurationError(
            "--sp-preset auto tunes to the coning in a passband", "give --passband HZ"
        )


def check_coning(group: ConingOptions) -> None:
    """Check that the options belong to the chosen algorithm and fit each other.

    Raises
    ------
    ConfigurationError
        An option has no effect with the algorithm, or a value is impossible.
    """
    _refuse_without_effect(group)
    options = group.algorithm_options()
    if group.coning == "gyro-tuned":
        # The log's interval is not known yet; any one shows whether the rest is possible.
        top = max(group.passband or 0.0, group.stopband or 0.0)
        algorithm(group.coning, **options, interval=0.25 / top if top else 1e-3)
    elif group.coning == "singular-perturbation" and group.sp_preset == "auto":
        strange = set(options) - {"preset", "passband", "variant"}
        if strange or group.sp_variant not in (None, "truncated"):
            raise ConfigurationError(
                "--sp-preset auto chooses the variant, epsilon and n itself",
                "leave out the other options of singular-perturbation",
            )
        _require_passband(group)
    elif options:
        try:
            algorithm(group.coning, **options)
        except ConfigurationError as exc:
            raise ConfigurationError(
                f"--coning is {group.coning}: {exc.message}", exc.hint
            ) from exc


def _refuse_without_effect(group: ConingOptions) -> None:
    taken = {"coning", *options_of(group.coning)}
    if group.sp_preset == "auto":
        taken.add("passband")
    chosen = [name for name in type(group).model_fields if getattr(group, name) is not None]
    strange = [name for name in chosen if name.removeprefix("sp_") not in taken]
    if strange:
        flags = listed([f"--{name.replace('_', '-')}" for name in strange])
        users = ("singular-perturbation", "gyro-tuned")
        own = [
            u for u in users if {name.removeprefix("sp_") for name in strange} & set(options_of(u))
        ]
        raise ConfigurationError(
            f"{flags} no effect with --coning {group.coning}",
            f"leave out what is not needed, or choose --coning {' or '.join(own)}",
        )


class ComparisonOptions(Group):
    """Coning algorithms compared on a log."""

    title = "Comparison"

    algorithms: tuple[str, ...] = option(
        (),
        "coning algorithms to compare (default: ten; with --paper those of the paper and more)",
        "A,B,...",
        brief="coning algorithms to compare (default: ten)",
    )
    reference: str = option(
        "auto",
        "algorithm that the others are measured against; auto (quatfiter-4), or none",
        "NAME",
        brief="algorithm that the others are measured against (default: quatfiter-4)",
    )
    decimate: tuple[Annotated[int, Field(ge=1)], ...] = option(
        (1, 2, 4),
        "also compare at the log's rate divided by these factors",
        "M,...",
        brief="also compare at the log's rate divided by these (default: 1,2,4)",
    )
    window: float = option(
        10.0,
        "length in s of the windows in which drift is measured",
        "S",
        gt=0,
        brief="windows in which drift is measured, in s (default: 10)",
    )
    tolerance: float = option(
        0.01,
        "drift that is too small to matter, deg/h",
        "DEG/H",
        brief="drift that is too small to matter, deg/h (default: 0.01)",
        ge=0,
    )
    truth: str | None = option(
        None,
        "true attitude, used as the reference: a topic (Imu, QuaternionStamped, PoseStamped or"
        " Odometry) or a CSV file",
        "TOPIC|FILE",
        brief="true attitude, used as the reference",
    )
    phase: Literal["consistent", "literal"] = option(
        "consistent",
        "with --paper: eq. (20) of the paper as its motion requires (consistent), or as printed"
        " (literal)",
    )

    @field_validator("algorithms")
    @classmethod
    def _algorithms(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(map(_exists, names)))

    @field_validator("reference")
    @classmethod
    def _reference(cls, name: str) -> str:
        return name if name in ("auto", "none") else _exists(name)

    @field_validator("decimate")
    @classmethod
    def _native_first(cls, numbers: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(dict.fromkeys((1, *numbers)))


def check_comparison(comparison: ComparisonOptions, coning: ConingOptions) -> None:
    """Whether the options of a comparison fit each other.

    Raises
    ------
    ConfigurationError
    """
    if comparison.truth is not None and comparison.reference != "auto":
        raise ConfigurationError("give --truth or --reference, not both")
    _require_passband(coning)
