"""CVODE and IDA of SUNDIALS for mbdkit, each as an `OdeSolver` of SciPy around scikit-sundae."""

from __future__ import annotations

from mbdkit.plugin import IntegratorPlugin, Target, hookimpl

mbdkit_api = 1


def _integrator(name: str, summary: str, options: str, create: str) -> IntegratorPlugin:
    home = "mbdkit_sundials.solvers"
    return IntegratorPlugin(
        name=name,
        summary=summary,
        options=Target(f"{home}:{options}", type),
        create=Target(f"{home}:{create}"),
        claims=Target(f"{home}:claims"),
        references=Target(f"{home}:REFERENCES", tuple),
        dense_output=True,
    )


@hookimpl
def mbdkit_integrators() -> list[IntegratorPlugin]:
    """Register the solvers, whose code is imported when a spec names them."""
    return [
        _integrator(
            "sundials-cvode",
            "CVODE of SUNDIALS: BDF or Adams, adaptive steps and order.",
            "CvodeOptions",
            "create_cvode",
        ),
        _integrator(
            "sundials-ida",
            "IDA of SUNDIALS: BDF on the residual, adaptive steps and order.",
            "SundialsOptions",
            "create_ida",
        ),
    ]
