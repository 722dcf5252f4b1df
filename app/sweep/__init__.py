"""Sweeps: settings of a scene or a case walked through, and what their accuracy costs in time."""
