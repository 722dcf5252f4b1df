"""Studies: what accuracy costs in time, which models recover, where laws draw a body."""
