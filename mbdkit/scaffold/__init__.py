"""Where a plugin begins: a distribution that installs, passes its tests and is ready to be changed."""
