"""The folder of a study: its lock, its owner, its tables of columns."""
