"""Compiled functions of Taylor series: recurrences of power series, of trees of pins, and one step."""
