"""The language of expressions: its parser, its operations with their derivatives, and its programs."""
