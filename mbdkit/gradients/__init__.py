"""Gradients: exact derivatives of measures of runs by parameters of the model, with a check by differences."""
