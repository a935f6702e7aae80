"""Derivatives of inverse dynamics by parameters."""
