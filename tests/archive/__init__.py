"""Tests of the run archive, on made-up data: no engine is needed."""
