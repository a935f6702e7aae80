"""The engine: compilation of mechanisms to flat arrays, assembly, analysis of redundancy, and equations of motion."""
