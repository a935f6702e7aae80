"""The packaged study `paper`: a published comparison of integration methods, recomputed and tested."""
