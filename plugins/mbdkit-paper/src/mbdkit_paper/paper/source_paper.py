"""The source paper that the packaged study `paper` repeats."""

from mbdkit.base.bibliography import entry

TITLE = (
    "A Comparative Analysis of Numerical Integration in Explicit and Implicit Methods to be Evaluated in the Linkage "
    "Model with Multibody Dynamics Toward an Optimum Design of Support Devices for Human Joint Workload Reduction"
)
BIBTEX = entry(__file__, "source-paper")
REFERENCES = (BIBTEX,)
