"""Project templates for new plugins."""
