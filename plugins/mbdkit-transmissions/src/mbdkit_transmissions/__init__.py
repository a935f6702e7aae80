"""Gears, racks, rolling wheels, belts, cams, slots and couplings: joints that are functions of the relative pose."""
