"""Force laws: those that ship, and those of a plugin."""
