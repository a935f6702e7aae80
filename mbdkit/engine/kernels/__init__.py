"""Compiled kernels: functions on flat arrays that evaluate the elements of a mechanism and solve its equations."""
