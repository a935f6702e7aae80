"""What people see of a study: summary, figures, report and tables."""
