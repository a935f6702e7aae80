"""Tests of the integrators: tableaus, stepping, stage equations, counters."""
