"""Contacts and force laws in SymPy, from which runs derive functions."""
