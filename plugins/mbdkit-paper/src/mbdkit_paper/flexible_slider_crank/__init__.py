"""The packaged study `flexible-slider-crank`: joint forces and misalignment of a linkage with a beam."""
