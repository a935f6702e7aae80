"""The packaged study `textbook-four-bar`: the four-bar linkage of a textbook and its published residuals."""
