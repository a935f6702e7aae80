"""The registry of plugins: models, integrators, force laws, studies and measures, built-in or installed."""
