"""What reports, plots and views consist of: the page model, and the one scene of a mechanism that all of them draw."""
