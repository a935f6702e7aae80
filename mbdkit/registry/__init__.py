"""The registry of plugins: models, integrators, force laws and studies, built-in or installed."""
