"""Models of legs, scaled by body mass and height."""
