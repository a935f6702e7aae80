"""Events: zero crossings of expressions of bodies, joints, energies and time."""
