"""Design: chooses numbers of a spec so that measures become small, within limits."""
