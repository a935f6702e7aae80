"""Files of measured motion and forces, read into tables."""
