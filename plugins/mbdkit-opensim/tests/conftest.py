"""Makes `osim_texts` importable, independent of how pytest collects the tests."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
