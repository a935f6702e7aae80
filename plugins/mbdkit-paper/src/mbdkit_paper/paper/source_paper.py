"""The source paper that the packaged study `paper` repeats."""

TITLE = (
    "A Comparative Analysis of Numerical Integration in Explicit and Implicit Methods to be Evaluated in the Linkage "
    "Model with Multibody Dynamics Toward an Optimum Design of Support Devices for Human Joint Workload Reduction"
)
BIBTEX = """\
@misc{source-paper,
  title = {A Comparative Analysis of Numerical Integration in Explicit and Implicit Methods to be Evaluated in the
           Linkage Model with Multibody Dynamics Toward an Optimum Design of Support Devices for Human Joint Workload
           Reduction},
  note = {Source paper of the study `paper`; its author and DOI are not known to us}}"""

REFERENCES = (BIBTEX,)
