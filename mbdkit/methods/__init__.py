"""Integration methods and controllers of their steps as data: coefficients, options, claims and references.

The algorithms are in `mbdkit.integrators`. The hash of kernel sources excludes this folder, so that an edit does not
cause recompilation. A new method is a file of this folder and an entry of `INTEGRATORS`; a new controller is a function
of `step_controls` and an entry of `STEP_CONTROLS`.
"""

from __future__ import annotations

from mbdkit.registry.items import IntegratorPlugin, StepControl
from mbdkit.registry.target import Target

_HERE = "mbdkit.methods."


def _integrator(
    name: str, summary: str, file: str, options: str, *, of: str = "", dense_output: bool = True, order: int
) -> IntegratorPlugin:
    """Return the item of a method in a file of this folder.

    `options`: file and name of the class of its options. `of`: word in the names of the functions of the method, where
    a file has several methods.
    """
    names = ("create", "claims", "REFERENCES")
    if of:
        names = (f"create_{of}", f"claims_of_{of}", f"REFERENCES_OF_{of.upper()}")
    create, claims, references = (Target(f"{_HERE}{file}:{own}") for own in names)
    return IntegratorPlugin(
        name, summary, Target(_HERE + options), create, claims, references, dense_output=dense_output, order=order
    )


def _step_control(name: str, summary: str, options: str, references: str, *, order: int) -> StepControl:
    """Return the item of a controller, whose function has its name."""
    options_of, create, references_of = (Target(f"{_HERE}step_controls:{own}") for own in (options, name, references))
    return StepControl(name, summary, options_of, create, references_of, order=order)


# fmt: off
#: The built-in integrators: explicit methods, collocation, partitioned methods and SciPy's solvers;
#: within a family by order of convergence, then by name.
INTEGRATORS = (
    _integrator(
        "rk-gill", "Runge-Kutta-Gill: explicit, 4 stages, order 4, fixed steps.",
        "rk_gill", "method_options:ExplicitOptions", dense_output=False, order=10,
    ),
    _integrator(
        "rk4", "Classical Runge-Kutta: explicit, 4 stages, order 4, fixed steps.",
        "rk4", "method_options:ExplicitOptions", dense_output=False, order=20,
    ),
    _integrator(
        "dopri5", "Dormand-Prince: explicit, 7 stages, order 5, fixed or adaptive steps.",
        "dopri5", "method_options:ControlledOptions", order=30,
    ),
    _integrator(
        "dop853", "Dormand-Prince: explicit, 12 stages, order 8, fixed or adaptive steps.",
        "dop853", "method_options:ControlledOptions", order=40,
    ),
    _integrator(
        "gauss", "Gauss-Legendre collocation: implicit, 1 to 6 stages, order 2 s, symmetric, symplectic; or adaptive.",
        "gauss", "gauss:GaussOptions", order=60,
    ),
    _integrator(
        "radau-iia", "Radau IIA collocation: implicit, 2, 3 or 5 stages, order 2 s - 1, L-stable; or adaptive steps.",
        "radau_iia", "radau_iia:RadauOptions", order=70,
    ),
    _integrator(
        "rattle", "RATTLE: order 2, symmetric, symplectic, no drift of positions and velocities, fixed steps.",
        "lobatto_pair", "lobatto_pair:RattleOptions", of="rattle", dense_output=False, order=80,
    ),
    _integrator(
        "lobatto-pair",
        "Lobatto IIIA-IIIB: 2 or 3 stages, order 2 s - 2, symmetric, symplectic, no drift, fixed steps.",
        "lobatto_pair", "lobatto_pair:PairOptions", dense_output=False, order=90,
    ),
    _integrator(
        "scipy-radau", "SciPy's Radau IIA: implicit, order 5, adaptive steps.",
        "scipy_methods", "scipy_methods:AdaptiveOptions", of="radau", order=100,
    ),
    _integrator(
        "scipy-dop853", "SciPy's DOP853: explicit, order 8, adaptive steps.",
        "scipy_methods", "scipy_methods:AdaptiveOptions", of="dop853", order=110,
    ),
    _integrator(
        "scipy-lsoda", "SciPy's LSODA: Adams and BDF with automatic switching, adaptive steps.",
        "scipy_methods", "scipy_methods:AdaptiveOptions", of="lsoda", order=120,
    ),
)
#: The built-in controllers of adaptive steps.
STEP_CONTROLS = (
    _step_control(
        "deadbeat", "Elementary controller: the error of the last step alone chooses the next.",
        "StepControlOptions", "OF_FILTERS", order=10,
    ),
    _step_control(
        "pi", "Proportional-integral controller, PI.3.4 by default: for steps that stability limits.",
        "PIOptions", "OF_PI", order=20,
    ),
    _step_control(
        "pid", "Proportional-integral-derivative controller, by default H312PID.",
        "PIDOptions", "OF_FILTERS", order=30,
    ),
    _step_control(
        "predictive", "Predictive controller of RADAU5, for implicit methods.",
        "StepControlOptions", "OF_PREDICTIVE", order=40,
    ),
    _step_control(
        "h211b", "Low-pass filter of order 1: smooth step sizes where accuracy limits them.",
        "H211bOptions", "OF_FILTERS", order=50,
    ),
    _step_control(
        "h312b", "Low-pass filter of order 2: very smooth step sizes where accuracy limits them.",
        "H312bOptions", "OF_FILTERS", order=60,
    ),
    _step_control(
        "h321", "Low-pass filter of order 1 that extrapolates trends of the step size.",
        "StepControlOptions", "OF_FILTERS", order=70,
    ),
)
# fmt: on
