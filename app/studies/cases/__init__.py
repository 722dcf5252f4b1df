"""Problems with an exact solution that no scene can express, for sweeps.

A case is a module with `KEYS`, its settings and their defaults, and `run(settings, comm)`, which returns a dict:
`error` (relative), `size` (degrees of freedom, particles or slots), `steps` (1), `iterations` (a dict of counts),
`diagnostics` (a dict, for the record), `seconds` of this rank's processor and `wall_seconds`, both without preparation,
and, where it failed, `failed`, the reason; an ArithmeticError is a failure too. Where the error is another than that
against an exact solution, `MEASURES` names what the setting "error" may choose.
"""
