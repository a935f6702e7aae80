"""Doubts about derivatives: where the expression of a measure has no derivative, or different ones on both sides, and
where assembly changes an initial value that is a parameter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.archive.headlines import is_at_end
from mbdkit.base.plain_data import Path, path_text
from mbdkit.expressions.operations import OF_PARTS, OPERATIONS
from mbdkit.measures.measure_compiler import ALONG
from mbdkit.measures.measure_expression import AT_END_OF_RUN, MeasureExpression
from mbdkit.runs.continuous_motion import EQUAL
from mbdkit.spec.run_spec import RunSpec
from mbdkit_gradients.derived_values import DerivedValue, of_operands
from mbdkit_gradients.differentiated_run import DifferentiatedRun
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import PreparedDerivatives

AT_ZERO = 1e-9  #: Operands below this share of the quantities from which they were computed count as zero.
#: Advice about functions without a derivative.
SMOOTH = (
    "a smooth function has one, as sqrt(x**2 + c**2) for abs(x), or (x + y + sqrt((x - y)**2 + c**2))/2 for max(x, y)"
)
#: Number of values from which the limit on one side of a point is extrapolated.
#:
#: For a motion with eight steps per period, the relative error of rates is below 1e-9.
LIMIT_POINTS = 8


class DoubtedMeasure:
    """A measure of a differentiated run, with the doubts about its derivatives.

    Attributes
    ----------
    doubts
        Warnings about derivatives that do not exist.
    remarks
        Extrema that are at the end of the run, as clauses.
    size
        Largest absolute value to which functions over time were applied, in SI units.
    """

    def __init__(self, run: DifferentiatedRun, expression: MeasureExpression):
        self.run, self.expression = run, expression
        self.doubts: list[str] = []
        self.remarks: list[str] = []
        self.size = 0.0

    def _note_end(self, name: str, rows: DerivedValue) -> None:
        """Add a remark if the extremum of a quantity with these values in the rows is that at the end of the run."""
        if is_at_end(rows.value if name == "max" else -rows.value):
            self.remarks.append(AT_END_OF_RUN.format(name))

    def _note_several(self, name: str, times: Sequence[float]) -> None:
        self.doubts.append(
            f"the {'largest' if name == 'max' else 'smallest'} value in '{self.expression.text}' is attained at "
            f"several times, such as t = {times[0]:.6g} s and {times[1]:.6g} s, so that it has no derivative; a p-norm "
            "is a smooth maximum: mean(x**8)**(1/8)"
        )

    def _note_corner(self, operation: str, operands: Sequence[DerivedValue]) -> None:
        """Add a warning if an operation on results of reductions over time has no derivative at these operands."""
        if operation in ALONG.values():
            self._note_equal_elements(operation, operands[0])
            return
        argument = switch_of(operation, operands)
        if argument is None or argument.value.shape[-1] != 1 or not argument.slope.any():
            return
        size = max(float(np.max(np.abs(operand.value))) for operand in operands)
        size = max(size, self.size) if operation in ("abs", "norm") else size
        if np.max(np.abs(argument.value)) <= AT_ZERO * size:
            is_size = operation in ("abs", "norm")
            what = "the operand of 'abs' is zero" if is_size else f"the operands of '{operation}' are equal"
            self._note_sides(what, SMOOTH)

    def _note_sides(self, what: str, advice: str) -> None:
        self.doubts.append(
            f"{what} in '{self.expression.text}', so that it has different derivatives on both sides and none there; "
            f"{advice}"
        )

    def _note_rest(self, switches: Sequence[DerivedValue], time: np.ndarray) -> None:
        """Add a warning if an operand stays at a value at which the integrand changes its form.

        The warning is given only if the parameters change this value.
        """
        for switch in switches:
            size = float(np.max(np.abs(switch.value), initial=0.0))
            rests = (np.abs(switch.value) <= 1e-14 * size) & (
                np.abs(switch.slope) > 1e-9 * np.max(np.abs(switch.slope), initial=0.0)
            ).any(0)
            if np.sum(rests) > len(time) // 100 + LIMIT_POINTS:
                self.doubts.append(
                    f"an operand in '{self.expression.text}' is zero over some time, from t = "
                    f"{time[np.argmax(rests)]:.6g} s, where 'abs', 'min' or 'max' has no derivative; {SMOOTH}"
                )
                return

    def _note_equal_elements(self, operation: str, rows: DerivedValue) -> None:
        """Add a warning if several elements of a beam have the extreme value, but different derivatives.

        Two times are examined: that of the extremum over time, and the end of the run.
        """
        values = rows.value if operation == "along_max" else -rows.value
        for row in {int(np.argmax(np.max(values, axis=0))), values.shape[1] - 1}:
            near = np.flatnonzero(values[:, row] >= np.max(values[:, row]) - EQUAL * np.max(np.abs(values)))
            slopes = rows.slope[:, near, row]
            if not np.allclose(slopes, slopes[:, :1], rtol=1e-6, atol=0.0):
                self.doubts.append(
                    f"the elements {near[0]} and {near[-1]} share the extreme value along the beam in "
                    f"'{self.expression.text}' at t = {self.run.rows.time[row]:.6g} s, so that it has no derivative; "
                    "name an element, as in beams.NAME.moment[0]"
                )


def switch_of(operation: str, operands: Sequence[DerivedValue]) -> DerivedValue | None:
    """Return the scalar whose sign determines the form of an operation; None if the form is fixed.

    See `mbdkit.measures.reductions.Functional.values_and_switches`. For the norm of a vector, the scalar is the product
    of the vector with its value at the first time.
    """
    kind = OPERATIONS[operation].switch if operation in OPERATIONS else ""
    if kind:
        return operands[0] if kind == "first" else of_operands("sub", 0.0, *operands)
    if operation not in OF_PARTS:
        return None
    x = operands[0]
    if operation == "norm":
        first = x.value[:, :1]
        return DerivedValue(np.sum(x.value * first, axis=0), np.sum(x.slope * first, axis=1))
    values = x.value if operation == "along_max" else -x.value
    one, other = np.argsort(values[:, -1])[:-3:-1] if len(values) > 1 else (0, 0)
    return DerivedValue(x.value[one] - x.value[other], x.slope[:, one] - x.slope[:, other])


#: For each key of a body: array of the initial state, and index of the first number among the three of the body.
COORDINATES = {"position": ("q", 0), "angle": ("q", 2), "velocity": ("v", 0), "angular_velocity": ("v", 2)}

#: Largest accepted deviation from 1 of the derivative of an assembled initial value with respect to the given one.
#:
#: A larger deviation means that the joints determine the initial value together with values of other bodies.
KEPT = 0.01


def start_doubts(spec: RunSpec, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> Iterator[str]:
    """Yield a warning for each initial coordinate or velocity of a body that is a parameter and that assembly changes.

    Parameters
    ----------
    prepared
        Derivatives of the initial state with respect to the parameters.
    """
    if spec.model_item.name != "mechanism":
        return  # the initial values of other models are coordinates that satisfy the joints
    bodies = list(spec.mechanism().bodies)
    for column, parameter in enumerate(parameters):
        for path in _initial_values(spec, parameter):
            array, place = COORDINATES[str(path[3])]
            slopes = prepared.seeds.get(array)
            row = 3 * bodies.index(str(path[2])) + place + (int(path[4]) if len(path) > 4 else 0)
            slope = 0.0 if slopes is None else float(slopes.reshape(-1, len(parameters))[row, column])
            if not np.abs(slope - 1.0) <= KEPT:
                yield (
                    f"the start after assembly changes by {slope:.3g} of a change of {path_text(path)}, because the "
                    f"joints connect it with other initial values; the gradient by {parameter.name} is that by the "
                    f"given value. Give all initial values that belong together as expressions of one parameter, or "
                    f"vary the start with `prepare(...).run(initial=...)`"
                )


def _initial_values(spec: RunSpec, parameter: Parameter) -> list[Path]:
    """Return the paths of the initial coordinates and velocities of bodies that a parameter sets directly.

    Such a value is the parameter itself, or is given as the name of the parameter alone.
    """
    paths = [parameter.path, *(path for path, text in spec.written.items() if text.strip() == parameter.name)]
    bodies = spec.mechanism().bodies
    return [
        path
        for path in paths
        if path[:2] == ("model", "bodies") and len(path) > 3 and path[2] in bodies and path[3] in COORDINATES
    ]
