"""CVODE and IDA of SUNDIALS for mbdkit, each as an `OdeSolver` of SciPy around scikit-sundae."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = {"methods": 1}

#: Solvers: name, class of the options, and summary.
SOLVERS = (
    ("cvode", "CvodeOptions", "CVODE of SUNDIALS: BDF or Adams, adaptive steps and order."),
    ("ida", "SundialsOptions", "IDA of SUNDIALS: BDF on the residual, adaptive steps and order."),
)


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the solvers, whose code is imported when a spec names them."""
    return [
        IntegratorPlugin(
            name=f"sundials-{name}",
            summary=summary,
            options=Target(f"mbdkit_sundials.solvers:{options}"),
            create=Target(f"mbdkit_sundials.solvers:create_{name}"),
            claims=Target("mbdkit_sundials.solvers:claims"),
            references=Target("mbdkit_sundials.solvers:REFERENCES"),
            dense_output=True,
        )
        for name, options, summary in SOLVERS
    ]
