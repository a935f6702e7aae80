"""Integration methods and controllers of their steps as data: coefficients, options, claims and references.

The algorithms are in `mbdkit.integrators`. The hash of kernel sources excludes this folder, so that an edit does not
cause recompilation. A new method is a file of this folder and an entry of `INTEGRATORS`; a new controller is a function
of `step_controls` and an entry of `STEP_CONTROLS`.
"""

from __future__ import annotations

from mbdkit.registry.items import IntegratorPlugin, StepControl
from mbdkit.registry.target import Target

# fmt: off
#: The built-in integrators: explicit methods, collocation, partitioned methods and SciPy's solvers;
#: within a family by order of convergence, then by name.
INTEGRATORS = (
    IntegratorPlugin(
        name="rk-gill", summary="Runge-Kutta-Gill: explicit, 4 stages, order 4, fixed steps.",
        options=Target("mbdkit.methods.method_options:ExplicitOptions"), create=Target("mbdkit.methods.rk_gill:create"),
        claims=Target("mbdkit.methods.rk_gill:claims"), references=Target("mbdkit.methods.rk_gill:REFERENCES"),
        order=10,
    ),
    IntegratorPlugin(
        name="rk4", summary="Classical Runge-Kutta: explicit, 4 stages, order 4, fixed steps.",
        options=Target("mbdkit.methods.method_options:ExplicitOptions"), create=Target("mbdkit.methods.rk4:create"),
        claims=Target("mbdkit.methods.rk4:claims"), references=Target("mbdkit.methods.rk4:REFERENCES"), order=20,
    ),
    IntegratorPlugin(
        name="dopri5", summary="Dormand-Prince: explicit, 7 stages, order 5, fixed or adaptive steps.",
        options=Target("mbdkit.methods.method_options:ControlledOptions"),
        create=Target("mbdkit.methods.dopri5:create"), claims=Target("mbdkit.methods.dopri5:claims"),
        references=Target("mbdkit.methods.dopri5:REFERENCES"), dense_output=True, order=30,
    ),
    IntegratorPlugin(
        name="dop853", summary="Dormand-Prince: explicit, 12 stages, order 8, fixed or adaptive steps.",
        options=Target("mbdkit.methods.method_options:ControlledOptions"),
        create=Target("mbdkit.methods.dop853:create"), claims=Target("mbdkit.methods.dop853:claims"),
        references=Target("mbdkit.methods.dop853:REFERENCES"), dense_output=True, order=40,
    ),
    IntegratorPlugin(
        name="gauss",
        summary="Gauss-Legendre collocation: implicit, 1 to 6 stages, order 2 s, symmetric, symplectic; or adaptive.",
        options=Target("mbdkit.methods.gauss:GaussOptions"), create=Target("mbdkit.methods.gauss:create"),
        claims=Target("mbdkit.methods.gauss:claims"), references=Target("mbdkit.methods.gauss:REFERENCES"),
        dense_output=True, order=60,
    ),
    IntegratorPlugin(
        name="radau-iia",
        summary="Radau IIA collocation: implicit, 2, 3 or 5 stages, order 2 s - 1, L-stable; or adaptive steps.",
        options=Target("mbdkit.methods.radau_iia:RadauOptions"), create=Target("mbdkit.methods.radau_iia:create"),
        claims=Target("mbdkit.methods.radau_iia:claims"), references=Target("mbdkit.methods.radau_iia:REFERENCES"),
        dense_output=True, order=70,
    ),
    IntegratorPlugin(
        name="rattle",
        summary="RATTLE: order 2, symmetric, symplectic, no drift of positions and velocities, fixed steps.",
        options=Target("mbdkit.methods.lobatto_pair:RattleOptions"),
        create=Target("mbdkit.methods.lobatto_pair:create_rattle"),
        claims=Target("mbdkit.methods.lobatto_pair:claims_of_rattle"),
        references=Target("mbdkit.methods.lobatto_pair:REFERENCES_OF_RATTLE"), order=80,
    ),
    IntegratorPlugin(
        name="lobatto-pair",
        summary="Lobatto IIIA-IIIB: 2 or 3 stages, order 2 s - 2, symmetric, symplectic, no drift, fixed steps.",
        options=Target("mbdkit.methods.lobatto_pair:PairOptions"), create=Target("mbdkit.methods.lobatto_pair:create"),
        claims=Target("mbdkit.methods.lobatto_pair:claims"),
        references=Target("mbdkit.methods.lobatto_pair:REFERENCES"), order=90,
    ),
    IntegratorPlugin(
        name="scipy-radau", summary="SciPy's Radau IIA: implicit, order 5, adaptive steps.",
        options=Target("mbdkit.methods.scipy_methods:AdaptiveOptions"),
        create=Target("mbdkit.methods.scipy_methods:create_radau"),
        claims=Target("mbdkit.methods.scipy_methods:claims_of_radau"),
        references=Target("mbdkit.methods.scipy_methods:REFERENCES_OF_RADAU"), dense_output=True, order=100,
    ),
    IntegratorPlugin(
        name="scipy-dop853", summary="SciPy's DOP853: explicit, order 8, adaptive steps.",
        options=Target("mbdkit.methods.scipy_methods:AdaptiveOptions"),
        create=Target("mbdkit.methods.scipy_methods:create_dop853"),
        claims=Target("mbdkit.methods.scipy_methods:claims_of_dop853"),
        references=Target("mbdkit.methods.scipy_methods:REFERENCES_OF_DOP853"), dense_output=True, order=110,
    ),
    IntegratorPlugin(
        name="scipy-lsoda", summary="SciPy's LSODA: Adams and BDF with automatic switching, adaptive steps.",
        options=Target("mbdkit.methods.scipy_methods:AdaptiveOptions"),
        create=Target("mbdkit.methods.scipy_methods:create_lsoda"),
        claims=Target("mbdkit.methods.scipy_methods:claims_of_lsoda"),
        references=Target("mbdkit.methods.scipy_methods:REFERENCES_OF_LSODA"), dense_output=True, order=120,
    ),
)
#: The built-in controllers of adaptive steps.
STEP_CONTROLS = (
    StepControl(
        name="deadbeat", summary="Elementary controller: the error of the last step alone chooses the next.",
        options=Target("mbdkit.methods.step_controls:StepControlOptions"),
        create=Target("mbdkit.methods.step_controls:deadbeat"),
        references=Target("mbdkit.methods.step_controls:OF_FILTERS"), order=10,
    ),
    StepControl(
        name="pi", summary="Proportional-integral controller, PI.3.4 by default: for steps that stability limits.",
        options=Target("mbdkit.methods.step_controls:PIOptions"), create=Target("mbdkit.methods.step_controls:pi"),
        references=Target("mbdkit.methods.step_controls:OF_PI"), order=20,
    ),
    StepControl(
        name="pid", summary="Proportional-integral-derivative controller, by default H312PID.",
        options=Target("mbdkit.methods.step_controls:PIDOptions"), create=Target("mbdkit.methods.step_controls:pid"),
        references=Target("mbdkit.methods.step_controls:OF_FILTERS"), order=30,
    ),
    StepControl(
        name="predictive", summary="Predictive controller of RADAU5, for implicit methods.",
        options=Target("mbdkit.methods.step_controls:StepControlOptions"),
        create=Target("mbdkit.methods.step_controls:predictive"),
        references=Target("mbdkit.methods.step_controls:OF_PREDICTIVE"), order=40,
    ),
    StepControl(
        name="h211b", summary="Low-pass filter of order 1: smooth step sizes where accuracy limits them.",
        options=Target("mbdkit.methods.step_controls:H211bOptions"),
        create=Target("mbdkit.methods.step_controls:h211b"),
        references=Target("mbdkit.methods.step_controls:OF_FILTERS"), order=50,
    ),
    StepControl(
        name="h312b", summary="Low-pass filter of order 2: very smooth step sizes where accuracy limits them.",
        options=Target("mbdkit.methods.step_controls:H312bOptions"),
        create=Target("mbdkit.methods.step_controls:h312b"),
        references=Target("mbdkit.methods.step_controls:OF_FILTERS"), order=60,
    ),
    StepControl(
        name="h321", summary="Low-pass filter of order 1 that extrapolates trends of the step size.",
        options=Target("mbdkit.methods.step_controls:StepControlOptions"),
        create=Target("mbdkit.methods.step_controls:h321"),
        references=Target("mbdkit.methods.step_controls:OF_FILTERS"), order=70,
    ),
)
# fmt: on
