"""Analyses without time integration: static equilibrium, linearised modes and kinematics of driven mechanisms."""
