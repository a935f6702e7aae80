"""The elements of reports, plots and views: the page model, and the scene of a mechanism that all of them draw."""
