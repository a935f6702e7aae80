"""Export of mechanisms to CasADi: their equations and quantities as symbolic functions."""
