"""Devices worn by persons, and the cuffs that attach them to limbs."""
