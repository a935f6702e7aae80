"""Compiled kernels: functions on flat arrays that evaluate, assemble, solve and observe a mechanism."""
