"""Step control: growth, cut-back, and times that are hit exactly."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from extremal.app.stepsize import StepSize


def walk(steps: StepSize) -> list[float]:
    """Return the times of a run without failures."""
    times = [0.0]
    while not steps.finished(times[-1]):
        dt, end = steps.propose(times[-1])
        assert dt == pytest.approx(end - times[-1], rel=1e-9)
        times.append(end)
        steps.accepted(dt, 3)
        assert len(times) < 100000
    return times


@given(
    end=st.floats(0.1, 10),
    parts=st.integers(1, 200),
    frames=st.one_of(st.none(), st.floats(0.02, 20)),
    adaptive=st.booleans(),
)
def test_end_and_every_output_time_are_hit_exactly_by_increasing_times(end, parts, frames, adaptive):
    steps = StepSize(first=end / parts, end=end, largest=end, adaptive=adaptive, every=frames)
    times = walk(steps)
    assert times[-1] == end
    assert all(b > a for a, b in zip(times, times[1:], strict=False))
    if frames is not None:
        expected = {k * frames for k in range(1, int(end / frames) + 1) if k * frames < end * (1 - 1e-9)}
        assert expected <= set(times)
        assert {t for t in times if steps.on_milestone(t)} == expected | {0.0, end}


def test_ten_fixed_steps_of_a_tenth_are_ten():
    assert len(walk(StepSize(first=0.1, end=1.0, adaptive=False))) == 11
    assert len(walk(StepSize(first=0.1, end=1.0))) == 11


def test_a_step_grows_after_two_easy_ones_up_to_the_largest_and_not_after_hard_ones():
    steps = StepSize(first=1.0, end=100.0, largest=2.0)
    steps.accepted(1.0, 50)
    steps.accepted(1.0, 3)
    assert steps.dt == 1.0
    steps.accepted(1.0, 3)
    assert steps.dt == 1.5
    for _ in range(4):
        steps.accepted(steps.dt, 3)
    assert steps.dt == 2.0


def test_a_failed_step_is_halved_down_to_the_smallest_and_then_refused():
    steps = StepSize(first=1.0, end=10.0, smallest=0.2)
    assert steps.rejected(1.0) and steps.dt == 0.5
    assert steps.rejected(0.5) and steps.dt == 0.25
    assert steps.rejected(0.25) and steps.dt == 0.2
    assert not steps.rejected(0.2)


def test_a_fixed_step_is_never_retried():
    assert not StepSize(first=1.0, end=10.0, adaptive=False).rejected(1.0)


def test_an_error_estimate_decides_alone():
    steps = StepSize(first=1.0, end=10.0, smallest=0.1, largest=2.0)
    steps.accepted(1.0, 500, wanted=1.7)
    assert steps.dt == 1.7
    steps.accepted(1.0, 1, wanted=9.0)
    assert steps.dt == 2.0
    assert steps.rejected(2.0, wanted=0.3) and steps.dt == 0.3


def test_what_remains_before_a_milestone_is_shared_by_two_steps_instead_of_leaving_a_sliver():
    steps = StepSize(first=0.3, end=1.0)
    assert walk(steps) == pytest.approx([0.0, 0.3, 0.6, 0.8, 1.0])


def test_restored_state_goes_on_alike_unless_the_scene_asks_for_another_step():
    steps = StepSize(first=1.0, end=100.0, largest=10.0)
    steps.rejected(1.0)
    steps.accepted(0.5)
    other = StepSize(first=1.0, end=100.0, largest=10.0)
    other.restore(steps.state())
    assert other.state() == steps.state()
    changed = StepSize(first=0.1, end=100.0, largest=10.0)
    changed.restore(steps.state())
    assert changed.dt == 0.1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"first": 0.0}, "time step 0: must be greater than 0"),
        ({"smallest": 3.0, "largest": 2.0}, "smallest step 3: must be greater than 0 and at most"),
        ({"every": -1.0}, "time between frames -1: must be greater than 0"),
    ],
)
def test_lengths_that_contradict_each_other_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        StepSize(**({"first": 1.0, "end": 10.0} | wrong))
