"""Description of a mechanism as plain data: bodies, joints, drivers, force elements and their initial state."""
