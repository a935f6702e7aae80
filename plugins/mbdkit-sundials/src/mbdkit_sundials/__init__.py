"""CVODE and IDA of SUNDIALS for mbdkit, each as an `OdeSolver` of SciPy around scikit-sundae."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the solvers, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name="sundials-cvode",
            summary="CVODE of SUNDIALS: BDF or Adams, adaptive steps and order.",
            options=Target("mbdkit_sundials.solvers:CvodeOptions"),
            create=Target("mbdkit_sundials.solvers:create_cvode"),
            claims=Target("mbdkit_sundials.solvers:claims"),
            references=Target("mbdkit_sundials.solvers:REFERENCES"),
            dense_output=True,
        ),
        IntegratorPlugin(
            name="sundials-ida",
            summary="IDA of SUNDIALS: BDF on the residual, adaptive steps and order.",
            options=Target("mbdkit_sundials.solvers:SundialsOptions"),
            create=Target("mbdkit_sundials.solvers:create_ida"),
            claims=Target("mbdkit_sundials.solvers:claims"),
            references=Target("mbdkit_sundials.solvers:REFERENCES"),
            dense_output=True,
        ),
    ]
