"""The registry: through which models and integrators arrive, ours and anybody's."""
