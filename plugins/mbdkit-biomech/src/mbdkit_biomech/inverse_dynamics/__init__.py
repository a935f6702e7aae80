"""Inverse dynamics: from a measured motion and loads to the forces of actuators and joints."""
