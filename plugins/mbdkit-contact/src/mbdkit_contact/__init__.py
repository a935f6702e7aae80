"""Rigid contacts: treatments with located impacts, and time-stepping methods."""
