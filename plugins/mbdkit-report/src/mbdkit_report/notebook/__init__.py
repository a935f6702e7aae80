"""Display of runs, mechanisms, studies, equilibria and modes in Jupyter notebooks: tables, pictures, animations."""
