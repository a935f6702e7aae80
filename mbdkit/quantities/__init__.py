"""The table of all quantities that runs record, and their computation from the states of a mechanism."""
