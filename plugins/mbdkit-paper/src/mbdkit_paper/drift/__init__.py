"""The packaged study `drift`: order, drift, energy and cost of formulations and stabilizations."""
