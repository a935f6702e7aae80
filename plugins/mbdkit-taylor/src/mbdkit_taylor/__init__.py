"""Taylor series of the motion of trees of pins, of any order."""
