"""What makes results doubtful: criteria on data, model and results."""
