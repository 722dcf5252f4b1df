"""Invertible hyperelasticity: laws, extensions, weak forms, the SNES problem, time integration."""
