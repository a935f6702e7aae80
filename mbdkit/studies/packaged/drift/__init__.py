"""The packaged study `drift`: formulations and stabilizations against drift, and their cost."""
