"""The table of all quantities that runs record, and how each is taken from the states of a mechanism."""
