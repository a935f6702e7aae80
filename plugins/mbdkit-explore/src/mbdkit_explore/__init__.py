"""Sliders in the browser: a mechanism whose motion and forces follow its parameters; served on this machine only."""
