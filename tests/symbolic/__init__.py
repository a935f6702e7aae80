"""Tests of the symbolic room: the generated kernels against complex step and against formulas written by hand."""
