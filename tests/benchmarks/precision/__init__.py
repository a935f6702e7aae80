"""Work against precision: what an error costs, in mbdkit and in the codes that a user would otherwise take."""
