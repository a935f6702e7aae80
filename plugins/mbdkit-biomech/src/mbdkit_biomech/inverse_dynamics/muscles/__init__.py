"""How muscles share the moments of joints."""
