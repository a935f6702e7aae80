"""What a model author writes: bodies, joints, drivers, force elements and their initial state, as plain data."""
