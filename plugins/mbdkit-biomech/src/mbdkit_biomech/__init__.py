"""Loads of human joints: inverse dynamics of measured motion, workload, and models of legs."""
