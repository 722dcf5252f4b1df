"""The tables of a scene for `extremal hawkes`: every key, its unit, its default and what it may be."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator

from .scene_common import Expected, PetscValue, Scene, Where
from .scene_fields import Boolean, Integer, NotNegative, Number, Positive, Problem, Table, Text, wrong

COUNTS = ("events", "incomplete", "unresolvable", "slots")
PARAMETERS = ("background", "branching", "decay", "supercritical")
BASELINES = ("guessing", "frequent", "linear")  # answers that need no reconstruction
SCORES = (
    *(f"top{k}{end}" for k in (1, 2, 3) for end in ("", "_low", "_high")),
    *(f"top{k}_{answer}" for k in (1, 2, 3) for answer in ("probabilities", *BASELINES)),
    "log_loss",
    *(f"log_loss_{answer}" for answer in BASELINES),
)
DIAGNOSTICS = (*COUNTS, *PARAMETERS, "drift", "energy", "gap", "tao_iterations", *SCORES)


def _moment(value: Any) -> float | str:
    """A time as a number or a text; TOML knows dates, too."""
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise wrong("must be a number, or a timestamp as 2024-05-31 or 2024-05-31T22:15")
    if not isinstance(value, str) and not math.isfinite(value):
        raise wrong("must be finite")
    return value if isinstance(value, str) else float(value)


Moment = Annotated[float | str, PlainValidator(_moment)]


class NetworkTable(Table):
    """[network]: who may have an event with whom, and the parameters of (2.3) where a pair has none of its own."""

    file: Text | None = Field(
        None, description="CSV file with the columns first, second and, if wished, background, branching, decay"
    )
    agents: Annotated[Integer, Field(ge=2, le=5000)] | None = Field(
        None, description="instead of a file: so many agents, named 1, 2, ..., any two of them a pair"
    )
    background: NotNegative = Field(0.01, description="μ, rate of events that nothing triggers [1/unit of time]")
    branching: NotNegative = Field(0.5, description="θ, mean number of events that an event triggers directly [1]")
    decay: Positive = Field(0.1, description="ω [1/unit of time]: what an event triggers follows after 1/ω in the mean")

    def problems(self) -> Iterator[Problem]:
        """Yield a network given twice or not at all."""
        if (self.file is None) == (self.agents is None):
            yield (), "must have either file or agents"


class EventsTable(Table):
    """[events]: what is known of the events."""

    file: Text = Field(description="CSV file with the columns time, first, second; unknown participants are left blank")
    unit: Literal["seconds", "minutes", "hours", "days", "weeks"] = Field(
        "days", description="unit of time of all parameters, and of times that are numbers"
    )
    begin: Moment | None = Field(
        None, description="beginning of the observation, written as times in the file are; default: the first event"
    )
    end: Moment | None = Field(
        None, description="end of the observation, written as times in the file are; default: the last event"
    )


class Simulation(Table):
    """[simulation]: events made up, whose participants are known and then removed."""

    count: Annotated[Integer, Field(ge=1, le=20_000_000)] | None = Field(None, description="number of events")
    duration: Positive | None = Field(None, description="instead: all events until this time [unit of time]")
    incomplete: Annotated[Integer, Field(ge=0)] = Field(
        description="number of events, chosen at random, that become incomplete"
    )
    missing: Literal["one", "both"] = Field("one", description="participants removed from them")
    unreported: Annotated[Number, Field(ge=0, lt=1)] = Field(
        0.0, description="share of all events that are lost before that, as if never reported [1]"
    )
    seed: Annotated[Integer, Field(ge=0)] = Field(1, description="of all random numbers of the simulation")

    def problems(self) -> Iterator[Problem]:
        """Yield a simulation without an end, or with two."""
        if (self.count is None) == (self.duration is None):
            yield (), "must have either count or duration"
        if self.count is not None and self.incomplete > self.count:
            yield ("incomplete",), f"must be at most count = {self.count}"


class Method(Table):
    """[method]: how the participants are found."""

    gap: Annotated[Number, Field(gt=0, lt=1)] = Field(
        1e-8, description="largest proven distance to the maximum of (3.5), over its energy, at which to stop [1]"
    )
    sweeps: Annotated[Integer, Field(ge=0, le=10_000)] = Field(
        5, description="rounds of maximising over one event after another before TAO begins"
    )
    p: Annotated[Number, Field(ge=1, le=100)] = Field(
        2.0, description="weights of an event have Σ x^p = 1 [1]: 2 is (3.5), 1 is (3.6)"
    )
    hybrid: Annotated[Number, Field(ge=-1, le=1)] | None = Field(
        None, description="instead of p: f in Σ f x² + (1 - f) x = 1 of section 3.2.3 [1]"
    )
    functional: Literal["energy", "normalised"] = Field(
        "energy",
        description="what is maximised: the energy (3.2), or (3.4), intensities relative to those of all pairs "
        "(small problems only)",
    )
    probabilities: Literal["mean_field", "gibbs", "exact", "none"] = Field(
        "mean_field",
        description="how probabilities are found: fast and nearly right, by sampling, by going through all ways of "
        "filling in up to 15 or so events, or not at all",
    )
    samples: Annotated[Integer, Field(ge=10, le=1_000_000)] = Field(
        200, description="gibbs: rounds of sampling over all incomplete events, in each of four chains"
    )
    seed: Annotated[Integer, Field(ge=0)] = Field(1, description="gibbs: of its random numbers")

    @property
    def is_default(self) -> bool:
        """Whether this is (3.5), which TAO solves to a proven gap."""
        return self.p == 2 and self.hybrid is None and self.functional == "energy"

    def problems(self) -> Iterator[Problem]:
        """Yield keys without effect."""
        given = self.model_fields_set
        if self.hybrid is not None and "p" in given:
            yield ("hybrid",), "is given instead of p; leave one of them out"
        if self.functional == "normalised":
            for key in ("p", "hybrid"):
                if key in given:
                    yield (key,), 'has no effect with functional = "normalised"'
        if not self.is_default:
            for key in ("gap", "sweeps"):
                if key in given:
                    yield (key,), 'belongs to (3.5), that is p = 2 without hybrid and with functional = "energy"'
        if self.probabilities != "gibbs":
            for key in ("samples", "seed"):
                if key in given:
                    yield (key,), f'needs probabilities = "gibbs", but that is "{self.probabilities}"'


class Estimation(Table):
    """[estimation]: parameters from the events themselves, by stochastic EM; of [network], only zeros count."""

    rounds: Annotated[Integer, Field(ge=1, le=100_000)] = Field(
        100, description="rounds of sampling participants and fitting parameters; the result is the mean of later ones"
    )
    per_pair: Boolean = Field(False, description="each pair has parameters of its own, drawn towards the common ones")
    shrinkage: NotNegative = Field(
        5.0, description="per_pair: how strongly, in events that would outweigh the common values [1]"
    )
    seed: Annotated[Integer, Field(ge=0)] = Field(1, description="of its random numbers")

    def problems(self) -> Iterator[Problem]:
        """Yield keys without effect."""
        if not self.per_pair and "shrinkage" in self.model_fields_set:
            yield ("shrinkage",), "needs per_pair = true"


class HawkesOutput(Table):
    """[output]: what is written."""

    candidates: Annotated[Integer, Field(ge=1)] = Field(
        10, description="rows of an event in predictions.csv at most: its pairs of largest weight"
    )
    checkpoint_every: Annotated[Integer, Field(ge=1)] = Field(20, description="rounds between checkpoints")
    summary: Boolean = Field(True, description="draw summary.png at the end")


@dataclass(frozen=True)
class Rounds:
    """What a session asks of [analysis]: a step is a round of estimation, the last one is the reconstruction."""

    end_time: float
    time_step: float = 1.0
    smallest_step: float = 1.0
    largest_step: float = 1.0
    adaptive: bool = False


class HawkesScene(Scene):
    """A scene for `extremal hawkes`."""

    title: Text = Field("", description="what the scene shows, in a line")
    part: Literal["hawkes"] = Field(description="which command runs it")
    network: NetworkTable = Field(description="who may have an event with whom")
    events: EventsTable | None = Field(None, description="what is known of the events; or [simulation]")
    simulation: Simulation | None = Field(
        None, description="events made up, whose participants are known and then removed; instead of [events]"
    )
    estimation: Estimation | None = Field(
        None, description="parameters from the events; absent: those of [network] are right"
    )
    method: Method = Field(default_factory=Method, description="how the participants are found")
    petsc: dict[str, PetscValue] = Field(default_factory=dict, description="PETSc options, without the dash")
    output: HawkesOutput = Field(default_factory=HawkesOutput, description="output")
    expect: dict[str, Expected] = Field(default_factory=dict, description="what the final diagnostics must be")

    @property
    def analysis(self) -> Rounds:
        """Steps of the run."""
        return Rounds(1.0 + (self.estimation.rounds if self.estimation is not None else 0))

    def files(self) -> Iterator[tuple[Where, Path]]:
        """Yield the tables of pairs and events."""
        if self.network.file is not None:
            yield ("network", "file"), self.beside(self.network.file)
        if self.events is not None:
            yield ("events", "file"), self.beside(self.events.file)
