"""The registry: through which models, integrators and force laws arrive, ours and anybody's."""
