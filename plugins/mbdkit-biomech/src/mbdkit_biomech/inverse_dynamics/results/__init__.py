"""The record of an inverse run, and what is said of it."""
