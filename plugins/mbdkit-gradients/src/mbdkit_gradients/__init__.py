"""Gradients: exact derivatives of measures with respect to parameters of the model, with a check by differences."""
