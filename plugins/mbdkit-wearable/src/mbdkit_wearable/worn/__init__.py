"""Devices that follow the measured motion of the limbs which wear them."""
