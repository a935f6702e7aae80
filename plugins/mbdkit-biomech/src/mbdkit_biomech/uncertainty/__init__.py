"""How the uncertainty of a person and of its muscles affects the results of inverse dynamics."""
