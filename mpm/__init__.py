"""Snow: splines, particles, grid, constitutive law, transfers, colliders, the step."""
