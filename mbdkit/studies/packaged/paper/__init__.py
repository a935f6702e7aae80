"""The packaged study `paper`: a published comparison of integration methods, computed again and judged."""
