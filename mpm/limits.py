"""How far a step may go: what refuses it, and which step to try instead."""

from __future__ import annotations

LEAST_VOLUME_CHANGE = 0.1  # of det(1 + dt grad v): a step that squeezes a particle further is refused
LARGEST_ROTATION = 1.0  # of any entry of dt grad v
LARGEST_TRAVEL = 2.0  # of the Courant number allowed: a step that accelerates a particle further is refused


class StepFailure(ArithmeticError):
    """A step was too long; the state is that before it.

    Attributes
    ----------
    wanted_step : float or None
        A step [s] that should succeed.
    """

    def __init__(self, message: str, wanted_step: float | None = None) -> None:
        super().__init__(message)
        self.wanted_step = wanted_step


def check(J: float, turn: float, cells: float, cfl: float, dt: float) -> None:
    """Refuse a step that deforms a particle too much.

    Parameters
    ----------
    J : float
        Smallest det(1 + Δt ∇v) of all particles.
    turn : float
        Largest entry of Δt ∇v in size.
    cells : float
        That the fastest particle crosses.
    cfl : float
        That a particle should not cross more of.
    dt : float [s]

    Raises
    ------
    StepFailure
    """
    if cells > LARGEST_TRAVEL * cfl:
        raise StepFailure(
            f"particles are accelerated across {cells:.2g} cells in dt {dt:.3g}",
            dt * min(0.5, (cfl / cells) ** 0.5),
        )
    if J < LEAST_VOLUME_CHANGE or turn > LARGEST_ROTATION:
        raise StepFailure(
            f"a particle is deformed too much in dt {dt:.3g}: det(1 + dt grad v) = {J:.3g}, "
            f"largest |dt grad v| = {turn:.3g}",
            dt / 2,
        )
