"""The spec of an identification: a base, experiments with measured data, parameters, sensors and intervals."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from mbdkit.plugin import FormatVersion, Number, Positive, RunSpec, SpecError, path_text, read_quantity, value_text
from mbdkit.plugin.mechanisms import pair
from mbdkit.plugin.specs import Count, Section, StrictSpec, check_name
from mbdkit.plugin.studies import Overrides


def _plain(given: object) -> object:
    """Return a number without its unit, which may only be percent, because other units cannot be checked here."""
    if quantity := read_quantity(given):
        value, unit = quantity
        if unit.si != "1":
            raise SpecError(f"should be a number in SI units, {value:.9g} [{unit.si}], not '{given}'")
        return value
    return given


SINumber = Annotated[Number, BeforeValidator(_plain)]
Interval = Annotated[tuple[Number, Number], BeforeValidator(pair("two numbers [lower, upper]"))]
SIInterval = Annotated[tuple[SINumber, SINumber], BeforeValidator(pair("two numbers [lower, upper]"))]
#: A number in SI units, or the name of a parameter to be estimated.
NumberOrName = Annotated[Number | str, BeforeValidator(_plain)]


class Prior(Section):
    """What is known of a parameter before the experiments: a normal distribution."""

    mean: SINumber
    """Mean."""
    deviation: Annotated[Positive, BeforeValidator(_plain)]
    """Standard deviation."""


class Estimated(Section):
    """A parameter to be estimated."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("start", "bounds", "prior")

    start: SINumber | None = None
    """Value at which the search begins; by default, the value in the base, or else the middle of the bounds."""
    bounds: SIInterval | None = None
    """Smallest and largest value; by default none."""
    prior: Prior | None = None
    """What is known of the parameter before the experiments."""

    @model_validator(mode="after")
    def _ordered(self) -> Estimated:
        if self.bounds is not None:
            low, high = self.bounds
            if low >= high:
                raise SpecError(f"the lower bound {low:g} should be below the upper bound {high:g}", key="bounds")
            if self.start is not None and not low <= self.start <= high:
                raise SpecError(f"is outside of the bounds, {low:g} to {high:g}", key="start")
        return self


class TimeColumn(Section):
    """The column of a file with times."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("unit",)

    column: str
    """Heading of the column, with or without a unit at its end."""
    unit: str | None = None
    """Unit of the times, such as ``ms``; by default, that in the heading, or s."""


def _column(given: object) -> object:
    return {"column": given} if isinstance(given, str) else given


class Measured(Section):
    """The column of a file with measured values."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("unit", "deviation", "file", "time")

    column: str
    """Heading of the column, with or without a unit at its end."""
    unit: str | None = None
    """Unit of the values, such as ``deg``; by default, that in the heading, or the SI unit."""
    deviation: Positive | None = None
    """Standard deviation of the noise, in this unit. By default, that of an observed quantity is estimated from the
    residuals. With that of an input, the bias that its noise causes in the estimates is stated."""
    file: str | None = None
    """File with the column, if it is not that of the experiment."""
    time: Annotated[TimeColumn, BeforeValidator(_column)] | None = None
    """The column with the times in this file, if it is not that of the experiment."""


class Signal(Measured):
    """The column of a file with an observed quantity."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*Measured.ABSENT_BY_DEFAULT, "correlation", "unwrap")

    correlation: Literal["none", "ar"] = "ar"
    """Whether the noise may be correlated in time: `ar` estimates an autoregressive model of order 1 from the
    residuals, `none` assumes independent noise."""
    unwrap: bool | Positive = True
    """Whether a column that wraps is continued over full turns: an angle whose values stay within one turn and jump by
    more than half a turn. A number is the range in which the column wraps, such as 65536 counts."""


class Sensor(Section):
    """How a sensor shows a quantity y: ``gain*y(t - delay) + offset``; numbers, or names of parameters."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("gain", "offset", "delay")

    gain: NumberOrName = 1.0
    """Factor, such as the counts per radian of an encoder; the column then has no `unit`."""
    offset: NumberOrName = 0.0
    """Value that the sensor shows if the quantity is zero, in the unit of the quantity times `gain`."""
    delay: NumberOrName = 0.0
    """Time by which the sensor is late [s]."""


def _initial(given: object) -> object:
    if isinstance(given, str) and given not in ("estimated", "rest"):
        raise SpecError(f"should be `estimated`, `rest` or a mapping of quantities, not {value_text(given)}")
    return given


class Experiment(Section):
    """One record of measured data."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        *("separator", "decimal", "inputs", "initial", "overrides", "window", "sensors", "role"),
    )

    file: str
    """File with a table, relative to the folder of the spec: .csv, .tsv, .txt, .dat, .mot, .sto, .trc or .c3d; empty
    cells are gaps."""
    separator: Literal[",", ";", "tab", "blank"] | None = None
    """What separates the cells of a text file; by default, it follows from the file."""
    decimal: Literal[".", ","] | None = None
    """Decimal point or comma of a text file; by default, it follows from the file."""
    time: Annotated[TimeColumn, BeforeValidator(_column)] = TimeColumn(column="time")
    """The column with the times: the heading alone, or a mapping. Clock times, and times since 1970, are counted from
    the first time in the file of the experiment."""
    observed: dict[str, Annotated[Signal, BeforeValidator(_column)]]
    """The measured quantities: expressions such as ``knee.angle`` or ``markers.tip.x``, each with its column: the
    heading alone, or a mapping."""
    inputs: dict[str, Annotated[Measured, BeforeValidator(_column)]] = Field(default_factory=dict)
    """Measured inputs of the mechanism, each with its column: the heading alone, or a mapping."""
    initial: (
        Annotated[Literal["estimated", "rest"] | dict[str, SINumber | SIInterval], BeforeValidator(_initial)] | None
    ) = None
    """The state at the beginning of the data. `estimated`: positions and velocities are estimated. `rest`: positions
    are estimated, velocities are zero. A mapping of quantities, such as ``{crank.angle: 0.3}``: numbers are exact, and
    two numbers are bounds of an estimate. By default, the start of the base."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base of this experiment, such as `parameters.load: 0`; a parameter that is set here is
    estimated from the other experiments."""
    window: Interval | None = None
    """First and last time that are used [s]; by default the whole file."""
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    """Sensors of this experiment; they replace those of the same quantities in the section `sensors`."""
    role: Literal["fit", "hold-out"] = "fit"
    """`hold-out`: these data do not affect the parameters, but test the prediction."""

    @model_validator(mode="after")
    def _complete(self) -> Experiment:
        if not self.observed:
            raise SpecError("needs at least one quantity, such as `{knee.angle: knee}`", key="observed")
        if self.window is not None and self.window[0] >= self.window[1]:
            raise SpecError("the first time should be before the last one", key="window")
        return self


class Shooting(Section):
    """Division of the experiments into windows, each with a state of its own at its beginning."""

    window: Positive
    """Duration of a window [s]."""


class Intervals(Section):
    """Intervals of the estimates."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("of",)

    level: Annotated[float, Field(gt=0.5, lt=1.0)] = 0.95
    """Probability with which an interval contains the true value."""
    method: Literal["profile", "linear"] = "profile"
    """`profile`: limits at which the best fit with a fixed value becomes significantly worse. `linear`: multiples of
    the standard deviation."""
    of: dict[str, str] = Field(default_factory=dict)
    """Expressions of the parameters for which intervals are computed too, by name, such as ``{ratio: "k/m"}``."""


class Candidate(Section):
    """A possible next experiment: other settings of the base of an experiment."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("overrides", "observed", "duration", "like")

    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base."""
    observed: list[str] | None = None
    """The quantities that are measured; by default those of the experiment that it is like. They need noise that is
    known from an experiment."""
    duration: Positive | None = None
    """Duration [s]; by default that of the experiment."""
    like: str | None = None
    """The experiment that is repeated with these settings; by default the first."""


class Narrowed(Section):
    """A quantity of a later run, whose interval the next experiment should narrow."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("overrides",)

    quantity: str
    """The quantity, such as ``joints.hip.force_y``; its widest interval in the run counts."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base, such as inputs that were not seen."""


def _check_parameters(given: dict[str, Estimated]) -> dict[str, Estimated]:
    if not given:
        raise SpecError("needs at least one parameter, such as `stiffness: {bounds: [0, 100]}`")
    return given


def _check_experiments(given: dict[str, Experiment]) -> dict[str, Experiment]:
    for name in given:
        check_name(name, path_text((name,)))
    if all(one.role == "hold-out" for one in given.values()):
        raise SpecError("needs at least one experiment with `role: fit`")
    return given


class IdentifySpec(StrictSpec):
    """The complete input of an identification.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(title="mbdkit identification spec", defer_build=True)

    mbdkit_identify: FormatVersion
    """Version of the spec format."""
    title: str = ""
    """Title, free text."""
    base: str | dict[str, Any]
    """The spec of a run: the name of a packaged example, a file, or a mapping."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base, such as `time.step: 0.002`."""
    kinematic: bool = False
    """Whether only positions are used: each sample has independent coordinates of its own, and lengths and offsets
    follow from the joints. The base then needs neither `integrator` nor `time`."""
    experiments: Annotated[dict[str, Experiment], AfterValidator(_check_experiments)]
    """Measured data, by name."""
    parameters: Annotated[dict[str, Estimated], AfterValidator(_check_parameters)]
    """The parameters to estimate: names of `parameters` of the base, dotted keys of numbers of its model, or names that
    only sensors use."""
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    """Gains, offsets and delays of sensors, by observed quantity."""
    shooting: Shooting | None = None
    """Division of the experiments into windows, for long and chaotic motions."""
    intervals: Intervals = Intervals()
    """Intervals of the estimates."""
    starts: Count = 1
    """Number of starts of the search: the first at the `start` of the parameters, the others in a Sobol sequence within
    their bounds."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random numbers."""
    loss: Literal["linear", "soft_l1", "huber", "cauchy", "arctan"] = "linear"
    """Loss of a residual, as in `scipy.optimize.least_squares`; all but `linear` reduce the influence of outliers."""
    candidates: dict[str, Candidate] = Field(default_factory=dict)
    """Possible next experiments, by name."""
    narrow: Narrowed | None = None
    """What the next experiment should narrow; by default, the interval of the first of `intervals.of`, or of the
    parameter with the widest relative interval."""

    _base: RunSpec | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _consistent(self) -> IdentifySpec:
        if self.kinematic:
            unused = [key for key in ("shooting", "candidates", "narrow") if getattr(self, key)]
            for name, record in self.experiments.items():
                own = [key for key in ("inputs", "initial") if getattr(record, key)]
                unused += [path_text(("experiments", name, key)) for key in own]
            if unused:
                raise SpecError("has no effect with `kinematic: true`; leave it out", key=unused[0])
        if self.narrow is not None and not self.candidates:
            raise SpecError("needs `candidates`, of which the best is chosen", key="narrow")
        for name, one in self.candidates.items():
            if one.like is not None and one.like not in self.experiments:
                raise SpecError(f"there is no experiment '{one.like}'", key=path_text(("candidates", name, "like")))
        if self.starts > 1 and (lacking := [name for name, one in self.parameters.items() if one.bounds is None]):
            raise SpecError(f"several starts need bounds of all parameters; '{lacking[0]}' has none", key="starts")
        observed = {quantity for one in self.experiments.values() for quantity in one.observed}
        for quantity in self.sensors:
            if quantity not in observed:
                raise SpecError("no experiment observes this quantity", key=path_text(("sensors", quantity)))
        return self

    @property
    def run_spec(self) -> RunSpec:
        """The validated base."""
        assert self._base is not None
        return self._base
