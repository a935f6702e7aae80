"""The conformance kit, held to a corpus of plugins that are each wrong in one way."""
