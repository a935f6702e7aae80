"""The engine: a mechanism compiled to flat arrays, its equations of motion, a consistent start, and its redundancy."""
