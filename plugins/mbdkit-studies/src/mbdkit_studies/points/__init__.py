"""The points of a study: their values, named and drawn."""
