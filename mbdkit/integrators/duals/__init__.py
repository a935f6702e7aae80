"""Steps with derivatives: runs in dual numbers."""
