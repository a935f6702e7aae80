"""What people see of results: figures, plots, animations, reports and views in notebooks."""
