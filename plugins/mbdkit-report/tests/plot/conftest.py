"""Fixtures of the plots' tests: synthetic runs."""

from __future__ import annotations

from tests.synthetic_runs import make_run as make_run
