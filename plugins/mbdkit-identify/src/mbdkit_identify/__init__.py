"""Identification: finds parameters of a model from measured motion, with intervals."""
