"""What Jupyter notebooks show of runs, mechanisms, studies, equilibria and modes: tables, pictures, animations."""
