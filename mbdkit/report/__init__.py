"""Pictures of a run: figures, animations and the drawing of a mechanism, all pure functions of what was recorded."""
