"""Attacks on reliability and security: `python -m tests.campaign`."""
