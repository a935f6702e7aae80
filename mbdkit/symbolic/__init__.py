"""Force laws in SymPy, from which runs derive functions."""
