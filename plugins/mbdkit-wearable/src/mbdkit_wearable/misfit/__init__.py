"""The packaged study `misfit`: what devices of the knee that do not fit add to its force, and what help is lost."""
