"""The elements of reports, plots and views: the page model, and the scene of a mechanism from which they are drawn."""
