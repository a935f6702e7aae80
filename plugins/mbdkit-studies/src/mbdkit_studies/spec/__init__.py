"""What a spec of a study says: axes, samples, measures, claims."""
